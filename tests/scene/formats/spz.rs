//! SPZ as it is written here.

use std::io::Read as _;
use std::path::Path;

use guard4d_engine::base::output::Existing;
use guard4d_engine::release::undo;
use guard4d_engine::scene::formats::spz::{decode, encode};
use guard4d_engine::scene::{Gaussians, Model};

use super::{golden, golden_bytes, splats_of};
use crate::scene::assert_refused;
use crate::support::close::largest;
use crate::support::fixture;

#[test]
fn a_scene_survives_to_within_half_a_step() {
    let splats = splats_of(&golden("scene.ply"));
    let bytes = encode(Path::new("scene.spz"), &splats).expect("it fits");
    let back = decode(Path::new("scene.spz"), &bytes).expect("our own file");
    let worst = |pairs: Vec<(f32, f32)>| largest(pairs.into_iter().map(|(a, b)| (a - b).abs()));
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
    let splats = splats_of(&golden("scene.ply"));
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
        // x is 1 of bytes, turned by 180 degrees: (w, x, y, z) = (0, 1, 0, 0) becomes (-1, 0, 0, 0) but for steps of
        // 1/127.5.
        assert!(splats.quats[0][0] < -0.99, "{name}: {:?}", splats.quats);
        assert!((splats.sh_coeffs[2] - 0.5 / 0.15).abs() < 1e-6, "{name}: blue is at its end");
    }
}

/// The bytes inside a gzip stream.
fn unzipped(bytes: &[u8]) -> Vec<u8> {
    let mut content = Vec::new();
    flate2::read::GzDecoder::new(bytes).read_to_end(&mut content).expect("a gzip stream");
    content
}

#[test]
fn a_marked_copy_in_kind_changes_only_colours_and_gives_them_back() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    // Version 3 in one stream and version 4 in several; the second is written as the first.
    for name in ["scene.v3.spz", "scene.v4.spz"] {
        let model = Model::open_in_kind(&golden(name)).expect(name);
        assert_eq!(model.gaussians, Model::open(&golden(name)).expect(name).gaussians, "{name}: read alike");
        let marked: Vec<f32> =
            model.gaussians.sh_coeffs.iter().map(|h| if *h == 0.0 { 0.0 } else { h + 0.004 }).collect();
        let stored = model.as_stored(&marked).expect("it fits");
        assert_eq!(model.as_stored(&stored).expect("it fits"), stored, "{name}: what lies on steps stays");
        let (out, private) = (folder.path().join(name), folder.path().join(name).with_extension("undo"));
        model.write_marked(&out, &stored).expect("writable");
        undo::write(&private, &model, &stored).expect("writable");
        let copy = Model::open_in_kind(&out.join(name)).expect("our own file");
        assert_eq!(
            copy.gaussians,
            Gaussians { sh_coeffs: stored, ..model.gaussians.clone() },
            "{name}: as it was judged"
        );
        let before = unzipped(model.sources()[0].bytes());
        let after = unzipped(copy.sources()[0].bytes());
        let n = model.gaussians.len();
        // Behind the head 9 bytes of position and one of opacity, 3 of colour, 7 of scale and rotation, then 45.
        let is_colour = |at: usize| (16 + 10 * n..16 + 13 * n).contains(&at) || at >= 16 + 20 * n;
        let changed: Vec<usize> = (0..before.len()).filter(|&at| before[at] != after[at]).collect();
        assert!(changed.len() > n && changed.iter().all(|&at| is_colour(at)), "{name}: {} bytes", changed.len());
        let restored = folder.path().join(format!("{name}.restored"));
        undo::restore(&out.join(name), &private, &restored, Existing::Refuse).expect("it is ours");
        let restored = std::fs::read(restored.join(name)).expect("restored");
        assert_eq!(unzipped(&restored), before, "{name}: the original's columns");
        if name == "scene.v3.spz" {
            assert_eq!(before, unzipped(&golden_bytes(name)), "as the other program packed them");
        }
    }
}

#[test]
fn offsets_fainter_than_a_step_are_left_on_average() {
    // Base colours have 255 steps for 1/0.15.
    let (n, step) = (1000, 1.0 / 0.15 / 255.0);
    let mut splats = fixture::gaussians(n, 0, 4);
    splats.sh_coeffs.iter_mut().for_each(|h| *h = h.clamp(-3.0, 3.0));
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("scene.spz");
    std::fs::write(&path, encode(&path, &splats).expect("it fits")).expect("writable");
    let model = Model::open_in_kind(&path).expect("our own file");
    for share in [0.1, 0.3, 0.77] {
        let moved = |h: &[f32]| -> Vec<f32> {
            let mut all = h.to_vec();
            all.chunks_exact_mut(48).flat_map(|c| &mut c[..3]).for_each(|h| *h += share * step);
            all
        };
        let marked = moved(&model.gaussians.sh_coeffs);
        let stored = model.as_stored(&marked).expect("it fits");
        for channel in 0..3 {
            let of = |h: &[f32]| -> f64 { h.iter().skip(channel).step_by(48).map(|h| f64::from(*h)).sum() };
            let kept = (of(&stored) - of(&model.gaussians.sh_coeffs)) / n as f64 / f64::from(step);
            // Discrepancy of a golden section sequence of 1000: below (1 + log2 1000) / 1000 (Niederreiter 1992,
            // theorem 3.4).
            assert!((kept - f64::from(share)).abs() < 0.011, "{share} of a step, channel {channel}: {kept}");
        }
    }
}
