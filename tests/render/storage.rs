//! What renderers keep of splats: numbers on their steps, and no farther off than half a step.

use guard4d_engine::render::storage::{Positions, Rotations, Steps, Storage};
use guard4d_engine::scene::Gaussians;
use guard4d_engine::scene::gaussians::{SH_FLOATS, Y0};

use crate::support::close::largest;
use crate::support::random::Random;

const SPLATS: usize = 500;

fn splats() -> Gaussians {
    let mut random = Random(7);
    let mut rows = |width: usize, low: f32, high: f32| random.vec_f32(width * SPLATS, low, high);
    Gaussians {
        means: rows(3, -2.0, 2.0).as_chunks().0.to_vec(),
        quats: rows(4, -1.0, 1.0).as_chunks().0.to_vec(),
        scales: rows(3, -8.0, 0.0).as_chunks().0.to_vec(),
        opacities: rows(1, -6.0, 6.0),
        sh_coeffs: rows(SH_FLOATS, -1.2, 1.2),
        sh_degree: 3,
    }
}

fn opacity(logit: f32) -> f32 {
    1.0 / (1.0 + (-logit).exp())
}

#[test]
fn exact_storage_changes_nothing() {
    assert_eq!(Storage::EXACT.kept(&splats()), splats());
}

#[test]
fn degrees_above_what_is_drawn_are_left_out() {
    for (degree, bases) in [(0, 1), (1, 4), (2, 9), (3, 16)] {
        let kept = Storage { sh_degree: degree, ..Storage::EXACT }.kept(&splats());
        assert_eq!(kept.sh_degree, degree);
        for (row, was) in kept.sh_coeffs.chunks(SH_FLOATS).zip(splats().sh_coeffs.chunks(SH_FLOATS)) {
            assert_eq!(row[..3 * bases], was[..3 * bases], "degree {degree}");
            assert!(row[3 * bases..].iter().all(|v| *v == 0.0), "degree {degree}");
        }
    }
    let flat = Gaussians { sh_degree: 1, ..splats() };
    assert_eq!(Storage::EXACT.kept(&flat).sh_degree, 1, "no degree is added");
}

#[test]
fn coefficients_lie_on_the_steps_of_their_degree() {
    let steps = [63.0, 127.0, 31.0];
    let kept = Storage { sh_steps: Some(steps), ..Storage::EXACT }.kept(&splats());
    for (row, was) in kept.sh_coeffs.chunks(SH_FLOATS).zip(splats().sh_coeffs.chunks(SH_FLOATS)) {
        assert_eq!(row[..3], was[..3], "base colours have steps of their own");
        for (base, (v, was)) in (1..16).flat_map(|base| [base; 3]).zip(row[3..].iter().zip(&was[3..])) {
            let steps = steps[if base < 4 { 0 } else { 1 + usize::from(base >= 9) }];
            let off = (v * steps - (v * steps).round()).abs();
            // A quotient and a product of single precision.
            assert!(off < 1e-4, "{v} on {steps} steps");
            assert!((v - was.clamp(-1.0, 1.0)).abs() <= 0.501 / steps, "{was} became {v}");
        }
    }
}

#[test]
fn colours_and_opacities_are_rounded_as_asked() {
    let nearest = Storage { colours: Steps::Nearest(255.0), opacities: Steps::Nearest(255.0), ..Storage::EXACT };
    let below = Storage { colours: Steps::Below(255.0), opacities: Steps::Below(255.0), ..Storage::EXACT };
    let colour = |dc: f32| 0.5 + dc * Y0 as f32;
    for (storage, low, high) in [(nearest, -0.501, 0.501), (below, -1.001, 0.001)] {
        let kept = storage.kept(&splats());
        for (row, was) in kept.sh_coeffs.chunks(SH_FLOATS).zip(splats().sh_coeffs.chunks(SH_FLOATS)) {
            for (dc, was) in row[..3].iter().zip(&was[..3]) {
                let moved = 255.0 * (colour(*dc) - colour(*was).clamp(0.0, 1.0));
                assert!(moved > low && moved < high, "moved by {moved} steps");
            }
            assert_eq!(row[3..], was[3..], "the rest stays");
        }
        for (logit, was) in kept.opacities.iter().zip(&splats().opacities) {
            let moved = 255.0 * (opacity(*logit) - opacity(*was));
            // The sigmoid of a logarithm of single precision.
            assert!(moved > low - 0.01 && moved < high + 0.01, "moved by {moved} steps");
        }
    }
}

#[test]
fn opacities_of_nothing_and_of_everything_are_kept_as_such() {
    let extreme = Gaussians { opacities: [-50.0, 50.0].repeat(SPLATS / 2), ..splats() };
    let kept = Storage { opacities: Steps::Nearest(255.0), ..Storage::EXACT }.kept(&extreme);
    assert!(kept.opacities.iter().all(|logit| logit.is_finite()), "{:?}", &kept.opacities[..2]);
    assert_eq!([opacity(kept.opacities[0]), opacity(kept.opacities[1])], [0.0, 1.0]);
}

#[test]
fn scales_and_positions_lie_on_their_steps() {
    let kept = Storage { scale_steps: Some(254.0), positions: Positions::Half, ..Storage::EXACT }.kept(&splats());
    let step = 21.0 / 254.0;
    for (log, was) in kept.scales.as_flattened().iter().zip(splats().scales.as_flattened()) {
        let number = (log + 12.0) / step;
        assert!((number - number.round()).abs() < 1e-3 && (log - was).abs() <= 0.501 * step, "{was} became {log}");
    }
    for (x, was) in kept.means.as_flattened().iter().zip(splats().means.as_flattened()) {
        // Half of the last of 11 bits.
        assert!((x - was).abs() <= was.abs() / 2048.0 && x.to_bits().trailing_zeros() >= 13, "{was} became {x}");
    }
}

#[test]
fn rotations_stay_close_and_are_kept_the_second_time() {
    // Half a step of the angle and of each coordinate of the axis, which a projection stretches; of what 1023 steps
    // and 128 hold, as much.
    for (rotations, most_rad) in [(Rotations::AxisAngle, 0.04), (Rotations::Folded, 0.005), (Rotations::Bytes, 0.02)] {
        let storage = Storage { rotations, ..Storage::EXACT };
        let (whole, kept) = (splats(), storage.kept(&splats()));
        let farthest = largest(kept.quats.iter().zip(&whole.quats).map(|(a, b)| angle_rad(*a, *b)));
        assert!(farthest < most_rad && farthest > 0.001, "{rotations:?}: {farthest} rad");
        let again = storage.kept(&kept);
        let farthest = largest(again.quats.iter().zip(&kept.quats).map(|(a, b)| angle_rad(*a, *b)));
        assert!(farthest < 0.5 * most_rad, "{rotations:?}: {farthest} rad the second time");
    }
    let none = Gaussians { quats: vec![[0.0; 4]; SPLATS], ..splats() };
    let kept = Storage { rotations: Rotations::AxisAngle, ..Storage::EXACT }.kept(&none);
    assert_eq!(kept.quats, none.quats, "a quaternion of no length stays");
}

/// The angle of the turn from one rotation to another.
fn angle_rad(a: [f32; 4], b: [f32; 4]) -> f32 {
    let unit = |q: [f32; 4]| glam::Quat::from_xyzw(q[1], q[2], q[3], q[0]).normalize();
    let turn = unit(a) * unit(b).conjugate();
    2.0 * turn.xyz().length().atan2(turn.w.abs())
}
