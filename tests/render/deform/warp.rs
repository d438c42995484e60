//! Deformable-3DGS: a trained network against another implementation, and models of this kind from folder to picture.

use std::fs;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::scene::{Gaussians, Model, Motion, ply};
use tempfile::TempDir;

use crate::support::close::largest;
use crate::support::fixture::gaussians;
use crate::support::golden::Golden;
use crate::support::gpu::device;
use crate::support::shared;

/// A folder as Deformable-3DGS writes it, with a network that was trained on another scene.
fn folder(splats: &Gaussians, run: &Path) -> TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    for (from, to) in [("deform.pth", "deform/iteration_40000/deform.pth"), ("cfg_args", "cfg_args")] {
        let to = folder.path().join(to);
        fs::create_dir_all(to.parent().expect("a folder")).expect("writable");
        fs::copy(run.join(from), to).expect("writable");
    }
    let cloud = folder.path().join("point_cloud/iteration_40000");
    fs::create_dir_all(&cloud).expect("writable");
    fs::write(cloud.join("point_cloud.ply"), ply::encode(splats)).expect("writable");
    folder
}

fn golden_splats(golden: &Golden) -> Gaussians {
    let triples = |name: &str| golden.f32(name).as_chunks().0.to_vec();
    let mut splats = gaussians(40, 3, 1);
    (splats.means, splats.scales) = (triples("means"), triples("scales"));
    splats.quats = golden.f32("quats").as_chunks().0.to_vec();
    splats
}

#[test]
fn a_trained_network_moves_splats_as_numpy_says() {
    let (Some(gpu), Some(run)) = (device(), shared("data/pth/deformable_standup_run256")) else { return };
    let golden = Golden::load("warp");
    let splats = golden_splats(&golden);
    let folder = folder(&splats, &run);
    let model = Model::open(folder.path()).expect("a Deformable-3DGS folder");
    assert!(matches!(model.motion, Motion::Warp(_)), "{:?}", model.motion);
    assert_eq!(model.background, [0.0; 3], "cfg_args say black");
    let mut field = DeformField::new(&gpu, &model.gaussians, &model.motion).expect("uploads");
    for (number, time) in golden.f32("times").into_iter().enumerate() {
        let state = field.at(time).expect("runs");
        let read = |buffer: &guard4d_kernels::Buffer<f32>| buffer.read().expect("readable");
        let raw = state.raw();
        let (means, scales, quats) = (read(raw.means), read(raw.scales), read(raw.quats));
        let want = |name: &str| golden.f32(&format!("{name}.{number}"));
        let rows = |data: &[f32]| -> Vec<f32> { data.chunks_exact(4).flat_map(|row| &row[..3]).copied().collect() };
        let scales: Vec<f32> = rows(&scales).into_iter().map(f32::exp).collect();
        let deviations: Vec<f32> = want("deviations").into_iter().map(f32::abs).collect();
        // The sine of 512 x has the rounding of x, 6e-8, 512 times; nine layers carry a few of these on.
        for (what, got, want) in
            [("means", rows(&means), want("means")), ("scales", scales, deviations), ("quats", quats, want("quats"))]
        {
            let worst = largest(got.iter().zip(&want).map(|(a, b)| (a - b).abs()));
            assert!(got.len() == want.len() && worst < 2e-4, "{what} at {time}: off by {worst}");
        }
    }
}

#[test]
fn a_moment_can_be_taken_out_with_the_same_ellipsoids() {
    let (Some(gpu), Some(run)) = (device(), shared("data/pth/deformable_standup_run256")) else { return };
    let golden = Golden::load("warp");
    let folder = folder(&golden_splats(&golden), &run);
    let model = Model::open(folder.path()).expect("a Deformable-3DGS folder");
    let mut field = DeformField::new(&gpu, &model.gaussians, &model.motion).expect("uploads");
    let still = field.at(1.0).and_then(|state| state.read()).expect("readable");
    let (deviations, quats) = (golden.f64("deviations.2"), golden.f64("quats.2"));
    for row in 0..still.len() {
        let [w, x, y, z] = [0, 1, 2, 3].map(|k| quats[4 * row + k]);
        // The matrix of a quaternion that is no unit, column by column.
        let matrix = DMat3::from_cols(
            DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
            DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
            DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
        );
        let half = matrix * DMat3::from_diagonal(DVec3::from_slice(&deviations[3 * row..3 * row + 3]));
        let want = half * half.transpose();
        let [w, x, y, z] = still.quats[row].map(f64::from);
        assert!((w * w + x * x + y * y + z * z - 1.0).abs() < 1e-6, "a unit quaternion");
        let scale = DVec3::from_array(still.scales[row].map(|s| f64::from(s).exp()));
        let half = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w)) * DMat3::from_diagonal(scale);
        let got = half * half.transpose();
        let most = largest(want.to_cols_array().map(f64::abs));
        // As the network's own error, twice for the square.
        let worst = largest((got - want).to_cols_array().map(f64::abs));
        assert!(worst < 4e-3 * most, "splat {row}: {worst} of {most}");
    }
}

#[test]
fn a_marked_folder_keeps_its_network_and_what_is_not_one_is_refused() {
    let Some(run) = shared("data/pth/deformable_standup_run256") else { return };
    let folder = folder(&gaussians(5, 3, 2), &run);
    let model = Model::open(folder.path()).expect("a Deformable-3DGS folder");
    let out = tempfile::tempdir().expect("a temporary folder can be made");
    let other = gaussians(5, 3, 3).sh_coeffs;
    model.write_marked(out.path(), &other).expect("writable");
    let copy = Model::open(out.path()).expect("the copy is a model");
    assert_eq!(copy.gaussians.sh_coeffs, other, "marked");
    let network = "deform/iteration_40000/deform.pth";
    let bytes = |root: &Path| fs::read(root.join(network)).expect("the network");
    assert_eq!(bytes(out.path()), bytes(folder.path()), "the same network");
    fs::write(folder.path().join(network), b"nothing").expect("writable");
    let error = Model::open(folder.path()).expect_err("no network");
    assert!(error.to_string().contains("deform.pth"), "{error}");
}
