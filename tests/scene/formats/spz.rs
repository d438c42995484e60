//! SPZ as it is written here.

use std::path::Path;

use guard4d_engine::scene::formats::spz::{decode, encode};

use super::super::{assert_refused, fixture};
use super::{golden_bytes, splats_of};

#[test]
fn a_scene_survives_to_within_half_a_step() {
    let splats = splats_of(&super::golden("scene.ply"));
    let bytes = encode(Path::new("scene.spz"), &splats).expect("it fits");
    let back = decode(Path::new("scene.spz"), &bytes).expect("our own file");
    let worst = |pairs: Vec<(f32, f32)>| pairs.into_iter().map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let flat =
        |a: &[[f32; 3]], b: &[[f32; 3]]| worst(a.iter().flatten().copied().zip(b.iter().flatten().copied()).collect());
    // Half of 1/4096, of 1/16 and of 1/255 by 0.15, with a rounding.
    assert!(flat(&back.means, &splats.means) < 1.01 * 0.5 / 4096.0, "positions");
    assert!(flat(&back.scales, &splats.scales) < 1.01 * 0.5 / 16.0, "log standard deviations");
    for (row, (got, want)) in back.sh_coeffs.chunks_exact(48).zip(splats.sh_coeffs.chunks_exact(48)).enumerate() {
        // Colours beyond ±3.33 and coefficients beyond ±1 are cut, which this scene has none of.
        let dc = worst(got[..3].iter().copied().zip(want[..3].iter().copied()).collect());
        assert!(dc < 1.01 * 0.5 / 255.0 / 0.15, "DC of splat {row}: {dc}");
        let rest = worst(got[3..].iter().copied().zip(want[3..].iter().copied()).collect());
        assert!(rest < 1.01 * 0.5 / 128.0, "SH of splat {row}: {rest}");
    }
    let angle = |a: [f32; 4], b: [f32; 4]| {
        let norm = |q: [f32; 4]| q.iter().map(|v| v * v).sum::<f32>().sqrt();
        let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        (dot / norm(a) / norm(b)).abs()
    };
    // Three components are off by half of 1/511/√2 at most, so that the cosine of half the angle is above 1 - 4e-6.
    assert!(back.quats.iter().zip(&splats.quats).all(|(a, b)| angle(*a, *b) > 1.0 - 4e-6), "rotations");
}

#[test]
fn eight_bits_for_each_coefficient_lose_less_than_the_usual_four() {
    let splats = splats_of(&super::golden("scene.ply"));
    let ours = encode(Path::new("scene.spz"), &splats).expect("it fits");
    let error = |bytes: &[u8]| {
        let back = decode(Path::new("scene.spz"), bytes).expect("an SPZ file");
        let pairs = back.sh_coeffs.chunks_exact(48).zip(splats.sh_coeffs.chunks_exact(48));
        pairs.flat_map(|(a, b)| a[3..].iter().zip(&b[3..])).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
    };
    let (fine, usual) = (error(&ours), error(&golden_bytes("scene.v3.spz")));
    assert!(fine < 0.1 * usual, "{fine} against {usual}");
}

#[test]
fn scenes_that_do_not_fit_are_refused() {
    let mut splats = fixture::gaussians(2, 0, 1);
    splats.means[1][2] = 2050.0;
    assert_refused(encode(Path::new("wide.spz"), &splats), &["coordinate", "-2050", "2048"]);
}

#[test]
fn older_versions_are_read() {
    // Version 1 has half floats for positions, versions 1 and 2 three bytes for a rotation.
    let head = |version: u32| {
        let mut bytes = b"NGSP".to_vec();
        bytes.extend(version.to_le_bytes());
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend([0, 12, 0, 0]);
        bytes
    };
    let tail = [200_u8, 128, 0, 255, 160, 176, 144, 255, 128, 128];
    let half = |v: f32| half::f16::from_f32(v).to_le_bytes();
    let first = [head(1), [half(1.5), half(-2.0), half(0.25)].concat(), tail.to_vec()].concat();
    let fixed = |v: i32| v.to_le_bytes()[..3].to_vec();
    let second = [head(2), [fixed(6144), fixed(-8192), fixed(1024)].concat(), tail.to_vec()].concat();
    for (name, data) in [("version 1", first), ("version 2", second)] {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut encoder, &data).expect("memory");
        let splats = decode(Path::new("old.spz"), &encoder.finish().expect("memory")).expect(name);
        assert_eq!(splats.means, [[1.5, 2.0, -0.25]], "{name}: turned about x");
        assert_eq!(splats.scales, [[0.0, 1.0, -1.0]], "{name}");
        // x is 1 of bytes, turned by 180 degrees: (w, x, y, z) = (0, 1, 0, 0) becomes (-1, 0, 0, 0) but for steps of 1/127.5.
        assert!(splats.quats[0][0] < -0.99, "{name}: {:?}", splats.quats);
        assert!((splats.sh_coeffs[2] - 0.5 / 0.15).abs() < 1e-6, "{name}: blue is at its end");
    }
}
