//! Splats on paths, sequences of files, and splats that cannot be drawn.

use std::fs;

use guard4d_engine::output::Existing;
use guard4d_engine::scene::ply::encode;
use guard4d_engine::scene::{Model, Motion};
use guard4d_engine::watermark::undo;

use super::super::{assert_refused, fixture};
use super::open_bytes;
use crate::support::random::Random;

const SPLATS: usize = 4;

/// A PLY as `SpacetimeGaussians` writes its variant "lite": 32 floats for each splat.
pub(crate) fn on_paths(splats: usize) -> Vec<u8> {
    let names = "x y z trbf_center trbf_scale nx ny nz motion_0 motion_1 motion_2 motion_3 motion_4 motion_5 motion_6 \
                 motion_7 motion_8 f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 omega_0 \
                 omega_1 omega_2 omega_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {splats}\n{properties}end_header\n");
    let values = Random(3).vec_f32(32 * splats, 0.0, 1.0);
    [head.into_bytes(), values.into_iter().flat_map(f32::to_le_bytes).collect()].concat()
}

#[test]
fn splats_on_paths_have_plain_colours() {
    let file = on_paths(SPLATS);
    let values = Random(3).vec_f32(32 * SPLATS, 0.0, 1.0);
    let model = open_bytes("take.ply", &file).expect("a file of splats on paths");
    let Motion::Paths(paths) = &model.motion else { panic!("{:?}", model.motion) };
    assert_eq!((paths.centres[1], paths.log_durations[1]), (values[35], values[36]), "time");
    assert_eq!(paths.motion[2], values[64 + 8..64 + 17], "motion");
    assert_eq!(paths.omega[3], values[96 + 28..96 + 32], "turn");
    // 0.28209479 h + 0.5 is the colour, with a rounding of h.
    let colour = 0.5 + 0.282_094_79 * model.gaussians.sh_coeffs[48];
    assert!((colour - values[32 + 17]).abs() < 1e-6, "red of splat 1");
    assert!(model.is_rgb() && model.gaussians.sh_degree == 0, "no SH");
}

#[test]
fn a_mark_on_plain_colours_can_be_taken_out_to_the_byte() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let (original, private) = (folder.path().join("take.ply"), folder.path().join("undo.safetensors"));
    let file = on_paths(SPLATS);
    fs::write(&original, &file).expect("writable");
    let model = Model::open(&original).expect("splats on paths");
    let mut marked = model.gaussians.sh_coeffs.clone();
    marked.chunks_exact_mut(48).flat_map(|splat| &mut splat[..3]).for_each(|value| *value += 0.013);
    let stored = model.as_stored(&marked).expect("it fits");
    let worst = marked.iter().zip(&stored).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 1e-6, "floats hold it but for a rounding of the colour: {worst}");
    let written = model.write_marked(&folder.path().join("marked"), &stored).expect("writable");
    undo::write(&private, &model, &stored).expect("writable");
    let copy = folder.path().join("marked").join(&written.marked[0]);
    let bytes = fs::read(&copy).expect("the copy");
    let changed = bytes.iter().zip(&file).filter(|(a, b)| a != b).count();
    assert!((SPLATS * 3..=SPLATS * 3 * 4).contains(&changed), "only colours: {changed} bytes");
    let restored = folder.path().join("restored");
    undo::restore(&copy, &private, &restored, Existing::Refuse).expect("it is ours");
    assert_eq!(fs::read(restored.join("take.ply")).expect("restored"), file, "the original's bytes");
}

#[test]
fn the_variant_with_a_network_is_refused() {
    let file = String::from_utf8_lossy(&on_paths(SPLATS)[..700]).replace("nx", "f_t_0");
    let file = [file.as_bytes(), &on_paths(SPLATS)[700..]].concat();
    assert_refused(open_bytes("take.ply", &file), &["f_t_0", "full", "lite"]);
}

#[test]
fn one_offset_marks_all_moments_of_a_sequence() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let take = folder.path().join("take");
    fs::create_dir(&take).expect("writable");
    let moments = [2_u64, 10, 9].map(|seed| (seed, fixture::gaussians(SPLATS, 1, seed)));
    for (number, splats) in &moments {
        fs::write(take.join(format!("frame_{number}.ply")), encode(splats)).expect("writable");
    }
    fs::write(take.join("licence.txt"), b"CC0").expect("writable");
    let model = Model::open(&take).expect("a sequence");
    let Motion::Sequence(read) = &model.motion else { panic!("{:?}", model.motion) };
    assert_eq!(read[0], moments[0].1, "frame 2 is first");
    assert_eq!(read[1], moments[2].1, "frame 9 comes before frame 10");
    let mut marked = model.gaussians.sh_coeffs.clone();
    marked.chunks_exact_mut(48).flat_map(|splat| &mut splat[..12]).for_each(|value| *value += 0.25);
    let written = model.write_marked(&folder.path().join("out"), &marked).expect("writable");
    assert_eq!(written.marked.len(), 3, "{written:?}");
    assert_eq!(written.copied, [std::path::PathBuf::from("licence.txt")], "other files come along");
    let Motion::Sequence(after) = Model::open(&folder.path().join("out")).expect("a sequence").motion else {
        panic!("still a sequence")
    };
    for (before, after) in read.iter().zip(&after) {
        assert_eq!((&after.means, &after.quats), (&before.means, &before.quats), "geometry stays");
        let offsets = after.sh_coeffs.iter().zip(&before.sh_coeffs).map(|(a, b)| a - b);
        // A rounding of values below 2.
        assert!(
            offsets.enumerate().all(|(i, d)| (d - if i % 48 < 12 { 0.25 } else { 0.0 }).abs() < 3e-7),
            "one offset"
        );
    }
    fs::write(take.join("frame_11.ply"), encode(&fixture::gaussians(SPLATS + 1, 1, 1))).expect("writable");
    assert_refused(Model::open(&take), &["splats", "5 of degree 1", "4 of degree 1"]);
}

#[test]
fn splats_that_cannot_be_drawn_are_left_out_and_kept() {
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut splats = fixture::gaussians(9, 3, 10);
        splats.means[4][1] = poison;
        splats.sh_coeffs[5 * 48 + 4] = poison;
        // The standard deviation e^100 is infinite in single precision.
        splats.scales[8][0] = 100.0;
        let file = encode(&splats);
        let model = open_bytes("holes.ply", &file).expect("six splats are sound");
        assert_eq!(model.gaussians.len(), 6, "three are left out");
        assert!(model.warnings[0].contains("3 splats of 9 left out"), "{:?}", model.warnings);
        let same = model.with_words(&model.words_of(&model.gaussians.sh_coeffs).expect("they fit"));
        assert_eq!(same, [file.as_slice()], "the copy holds all nine as they were");
        let other = fixture::gaussians(6, 3, 11).sh_coeffs;
        let copy = model.with_words(&model.words_of(&other).expect("they fit")).concat();
        let copy = open_bytes("holes.ply", &copy).expect("a copy");
        assert_eq!(copy.gaussians.sh_coeffs, other, "what was asked for");
        assert_eq!(copy.gaussians.means, model.gaussians.means, "the same splats");
    }
    let mut all = fixture::gaussians(2, 0, 1);
    all.opacities.fill(f32::NAN);
    assert_refused(open_bytes("none.ply", &encode(&all)), &["2, all with values that are not finite"]);
}
