//! Random scenes: the same from the same stream, unlike each other, and coloured as captures are.

use std::path::Path;

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose};
use guard4d_engine::scene::gaussians::CHANNELS;
use guard4d_engine::scene::{Model, procedural};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

fn scene(index: u64) -> Model {
    let prf = Prf::new(&MasterSecret::from_bytes([3; 32]));
    procedural::scene(&mut prf.stream(Purpose::Scenes, index)).expect("a scene")
}

#[test]
fn a_stream_gives_one_scene() {
    assert_eq!(scene(0).gaussians, scene(0).gaussians);
    assert_ne!(scene(0).gaussians.means, scene(1).gaussians.means, "another stream, another scene");
}

/// Deviation of the DC colours from black along the axis that they use least, and along the next.
fn deviations(model: &Model) -> [f64; 2] {
    const Y0: f64 = 0.282_094_791_773_878_14;
    let mut moment = Matrix3::zeros();
    for coeffs in model.gaussians.sh_coeffs.chunks_exact(16 * CHANNELS) {
        let colour = Vector3::from_fn(|c, _| 0.5 + Y0 * f64::from(coeffs[c]));
        moment += colour * colour.transpose() / model.gaussians.len() as f64;
    }
    let mut values: Vec<f64> = SymmetricEigen::new(moment).eigenvalues.iter().copied().collect();
    values.sort_by(f64::total_cmp);
    [values[0].max(0.0).sqrt(), values[1].max(0.0).sqrt()]
}

#[test]
fn scenes_have_finite_splats_and_a_colour_axis_that_they_hardly_use() {
    let mut unused = 0;
    for index in 0..12 {
        let model = scene(index);
        assert!((5_000..16_000).contains(&model.gaussians.len()), "{} splats", model.gaussians.len());
        assert_eq!(model.gaussians.sh_degree, 1, "SH degree");
        assert!(model.background.iter().all(|c| (0.0..=1.0).contains(c)), "{:?}", model.background);
        let [least, next] = deviations(&model);
        assert!(next > least && next < 0.7, "axes {least} and {next}");
        unused += usize::from(least < 0.05);
    }
    // Of robot, fox and fruit it is below 0.005; here the palette draws up to 0.02, and clamping to [0, 1] adds to it.
    assert!(unused >= 10, "{unused} of 12 leave an axis nearly free");
}

#[test]
fn a_scene_that_is_written_opens_again() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let model = scene(5);
    let written = folder.path().join("procedural.ply");
    std::fs::write(&written, model.sources()[0].bytes()).expect("writable");
    assert_eq!(Model::open(Path::new(&written)).expect("a static PLY").gaussians, model.gaussians);
}
