//! Splats that are near each other are one, with their mean and covariance.

use guard4d_engine::locate::merged::merged;
use guard4d_engine::scene::Gaussians;
use guard4d_engine::scene::ellipsoid::covariance;
use guard4d_engine::scene::gaussians::SH_FLOATS;

use crate::support::close::assert_close;

/// Splats at places along x, as large as that and this opaque, each of a colour of its own.
fn splats(rows: &[[f32; 3]]) -> Gaussians {
    let mut all = Gaussians { sh_degree: 1, ..Gaussians::default() };
    for (number, [x, deviation, opacity]) in rows.iter().enumerate() {
        all.means.push([*x, 0.25, 0.25]);
        all.quats.push([1.0, 0.0, 0.0, 0.0]);
        all.scales.push([deviation.ln(); 3]);
        all.opacities.push((opacity / (1.0 - opacity)).ln());
        let mut sh = [0.0; SH_FLOATS];
        sh[number % 3] = 1.0;
        sh[9] = number as f32;
        all.sh_coeffs.extend(sh);
    }
    all
}

#[test]
fn splats_in_one_cube_are_one_with_their_mean_and_covariance() {
    let own = splats(&[[0.2, 0.01, 0.6], [3.2, 0.01, 0.6], [0.6, 0.01, 0.2], [0.4, 2.0, 0.5]]);
    let fewer = merged(&own, 1.0);
    assert_eq!((fewer.len(), fewer.sh_degree), (3, 1), "one of two, one elsewhere, and one that is larger than a cube");
    // Each as much as it covers: three to one.
    let expected = 0.75 * 0.2 + 0.25 * 0.6;
    // Sums of two in double precision.
    assert_close(&fewer.means[0], &[expected, 0.25, 0.25], 1e-6, 0.0);
    assert_close(&[fewer.sh_coeffs[0], fewer.sh_coeffs[2], fewer.sh_coeffs[9]], &[0.75, 0.25, 0.5], 1e-6, 0.0);
    let spread = 0.75 * 0.25 * 0.4f32.powi(2) + 0.01f32.powi(2);
    let own_covariance = covariance(fewer.scales[0], fewer.quats[0]);
    let diagonal = [0, 1, 2].map(|axis| own_covariance[(axis, axis)] as f32);
    assert_close(&diagonal, &[spread, 1e-4, 1e-4], 1e-7, 1e-4);
    // As much is covered as by both, spread over more.
    let covered = |deviations: [f32; 3], logit: f32| {
        let [x, y, z] = deviations.map(f32::exp);
        (x * y + y * z + x * z) / (1.0 + (-logit).exp())
    };
    let both = covered(own.scales[0], own.opacities[0]) + covered(own.scales[2], own.opacities[2]);
    assert_close(&[covered(fewer.scales[0], fewer.opacities[0])], &[both], 0.0, 1e-3);
    // The others are as they were.
    assert_eq!((fewer.means[1], fewer.scales[1]), (own.means[1], own.scales[1]));
    assert_eq!((fewer.means[2], fewer.opacities[2]), (own.means[3], own.opacities[3]));
    assert_eq!(fewer.sh_coeffs[SH_FLOATS..2 * SH_FLOATS], own.sh_coeffs[SH_FLOATS..2 * SH_FLOATS]);
}

#[test]
fn splats_on_top_of_each_other_are_no_more_than_opaque() {
    let fewer = merged(&splats(&[[0.5, 0.1, 0.9]; 4]), 1.0);
    assert_eq!(fewer.len(), 1);
    let opacity = 1.0 / (1.0 + (-fewer.opacities[0]).exp());
    assert!((opacity - 0.99).abs() < 1e-4, "{opacity}");
    assert_eq!(merged(&Gaussians::default(), 1.0).len(), 0);
}
