//! Files that other tools have written.

use guard4d_engine::scene::formats::Format;
use guard4d_engine::scene::{Model, Motion};

use super::super::{assert_same_scene, golden, golden_bytes, open_bytes, splats_of};
use crate::support::close::largest;
use crate::support::shared;

/// Other code computes the same values in double precision; ours differ by roundings of values up to 10.
const ROUNDING: f32 = 2e-6;

#[test]
fn packed_files_are_read_as_splat_transform_reads_them() {
    for (name, format) in [
        ("scene.v3.spz", Format::Spz),
        ("scene.v4.spz", Format::Spz),
        ("scene.compressed.ply", Format::CompressedPly),
        ("scene.sog", Format::Sog),
    ] {
        let model = Model::open(&golden(name)).expect(name);
        assert_eq!(model.sources()[0].format(), format, "{name}");
        assert!(model.warnings.iter().any(|w| w.contains("coarsely")), "{name}: {:?}", model.warnings);
        // Opacities at the ends of a byte are kept half a step inside, which no picture shows.
        let mut want = splats_of(&golden(&format!("{name}.ply")));
        let half_step = 0.5 / 255.0;
        want.opacities.iter_mut().for_each(|logit| {
            let opacity = (1.0 / (1.0 + (-*logit).exp())).clamp(half_step, 1.0 - half_step);
            *logit = (opacity / (1.0 - opacity)).ln();
        });
        assert_same_scene(&model.gaussians, &want, 5.0 * ROUNDING, name);
    }
}

#[test]
fn a_glb_is_the_scene_that_it_was_made_from() {
    let model = Model::open(&golden("scene.glb")).expect("a glTF binary");
    assert_same_scene(&model.gaussians, &splats_of(&golden("scene.ply")), 5.0 * ROUNDING, "scene.glb");
}

#[test]
fn names_do_not_decide_what_a_file_is() {
    let model = open_bytes("scene.ply", &golden_bytes("scene.v4.spz")).expect("told by its content");
    assert_eq!(model.sources()[0].format(), Format::Spz, "an SPZ in disguise");
    let named = model.sources()[0].path().file_name().expect("a name");
    assert_eq!(named, "scene.ply", "what a copy is called");
}

#[test]
fn real_captures_are_read_whole() {
    let Some(folder) = shared("data/static") else { return };
    let open = |name: &str| Model::open(&folder.join(name)).expect(name);
    let (spz, packed) = (open("biker.spz").gaussians, open("biker.compressed.ply").gaussians);
    assert_eq!((spz.len(), packed.len()), (152_746, 152_746), "both hold all splats of the capture");
    // The same capture in two formats: its extent is the same to their coarsest step.
    let extent = |splats: &guard4d_engine::scene::Gaussians| {
        let along = |axis: usize| splats.means.iter().map(move |mean| mean[axis]);
        [0, 1, 2].map(|axis| largest(along(axis)) + largest(along(axis).map(|x| -x)))
    };
    for (a, b) in extent(&spz).iter().zip(extent(&packed)) {
        assert!((a - b).abs() < 0.01 * b, "{a} against {b} along an axis");
    }
    for axis in 0..3 {
        let (a, b) = (spz.median_centre()[axis], packed.median_centre()[axis]);
        assert!((a - b).abs() < 0.01, "the middle along axis {axis}: {a} against {b}");
    }
    for (name, count, degree) in [
        ("guitar.compressed.ply", 90_854, 0),
        ("engine_test_sh3.compressed.ply", 64, 3),
        ("skull.sog", 94_936, 3),
        ("khr_conformance_matrix.glb", 15, 3),
        ("fruit_drops_minimal.ply", 4_721, 3),
        ("three_points_from_train.ply", 3, 3),
    ] {
        let model = open(name);
        assert_eq!((model.gaussians.len(), model.gaussians.sh_degree), (count, degree), "{name}");
        assert!(model.motion.is_still(), "{name} stands still");
    }
}

#[test]
fn flipbooks_are_sequences() {
    let Some(folder) = shared("data/dynamic/wave_flipbook") else { return };
    let model = Model::open(&folder).expect("a folder of SOG files");
    let Motion::Sequence(moments) = &model.motion else { panic!("a file for each moment: {:?}", model.motion) };
    assert_eq!((moments.len(), model.sources().len()), (20, 20), "all moments");
    assert!(moments.iter().all(|moment| moment.len() == 4_225), "as many splats in each");
    assert_ne!(moments[0].means, moments[10].means, "the wave moves");
}

#[test]
fn moving_splats_of_a_viewer_are_read_without_the_broken_ones() {
    let Some(file) = shared("data/dynamic/hanabi2.splatv") else { return };
    let model = Model::open(&file).expect("a .splatv file");
    let Motion::Paths(paths) = &model.motion else { panic!("splats on paths") };
    assert_eq!((paths.centres.len(), model.gaussians.len()), (24_000, 24_000), "a path for each splat");
    assert!(model.warnings.is_empty(), "the zeros behind them are no splats: {:?}", model.warnings);
    let Some(file) = shared("data/restricted-nc/coffee10.splatv") else { return };
    let model = Model::open(&file).expect("a file that is shorter than it says");
    // 24 of its positions are NaN; four durations are infinite, which is how splats that never fade come out.
    assert!(model.warnings.iter().any(|w| w.contains("24 splats of 11926 left out")), "{:?}", model.warnings);
    assert_eq!(model.gaussians.len(), 11_902);
}
