//! Splats on paths.

use std::fs;

use guard4d_engine::base::output::Existing;
use guard4d_engine::release::undo;
use guard4d_engine::scene::{Model, Motion};

use crate::scene::assert_refused;
use crate::scene::formats::open_bytes;
use crate::support::close::largest;
use crate::support::random::Random;

const SPLATS: usize = 4;

/// A PLY as `SpacetimeGaussians` writes its variant "lite": 32 floats for each splat.
pub(crate) fn on_paths(splats: usize) -> Vec<u8> {
    let names = "x y z trbf_center trbf_scale nx ny nz motion_0 motion_1 motion_2 motion_3 motion_4 motion_5 motion_6 \
                 motion_7 motion_8 f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 \
                 omega_0 omega_1 omega_2 omega_3";
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
    let worst = largest(marked.iter().zip(&stored).map(|(a, b)| (a - b).abs()));
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
