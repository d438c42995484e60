//! Splat files of other tools: read as those tools read them, written back in kind, and refused with a reason.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::{Gaussians, Model, PlyFile};

use crate::support::close::largest;
use crate::support::repo;

mod format;
mod glb;
mod spz;

/// A file that splat-transform has written (`tests/golden/formats/README.md`).
fn golden(name: &str) -> std::path::PathBuf {
    repo("tests/golden/formats").join(name)
}

fn golden_bytes(name: &str) -> Vec<u8> {
    std::fs::read(golden(name)).expect(name)
}

/// The splats of a PLY that holds them one to one.
fn splats_of(path: &Path) -> Gaussians {
    PlyFile::open(path).and_then(|ply| ply.decode()).expect("a plain PLY")
}

/// R S Sᵀ Rᵀ: axes may come in another order of signs and still be the same ellipsoid.
fn covariance(splats: &Gaussians, row: usize) -> DMat3 {
    let [w, x, y, z] = splats.quats[row].map(f64::from);
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let scale = DMat3::from_diagonal(DVec3::from_array(splats.scales[row].map(|s| f64::from(s).exp())));
    let half = rotation * scale;
    half * half.transpose()
}

/// Opens bytes as the file `name`.
pub(super) fn open_bytes(name: &str, bytes: &[u8]) -> Result<Model, EngineError> {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a temporary folder is writable");
    Model::open(&path)
}

/// Fails unless two scenes are drawn alike: means, covariances as a share of their largest entry, opacities as shares
/// of light, and colours within `tolerance`.
#[track_caller]
fn assert_same_scene(got: &Gaussians, want: &Gaussians, tolerance: f32, what: &str) {
    assert_eq!((got.len(), got.sh_degree), (want.len(), want.sh_degree), "{what}: splats and degree");
    let close = |a: f32, b: f32| (a - b).abs() <= tolerance;
    let opacity = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    for row in 0..got.len() {
        let at = format!("{what}, splat {row}");
        let all = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| close(*a, *b));
        assert!(all(&got.means[row], &want.means[row]), "{at}: {:?} {:?}", got.means[row], want.means[row]);
        let (a, b) = (covariance(got, row), covariance(want, row));
        let most = largest(b.to_cols_array().map(f64::abs));
        assert!((a - b).to_cols_array().iter().all(|d| d.abs() <= f64::from(tolerance) * most), "{at}: {a} {b}");
        assert!(close(opacity(got.opacities[row]), opacity(want.opacities[row])), "{at}: opacity");
    }
    let worst = largest(got.sh_coeffs.iter().zip(&want.sh_coeffs).map(|(a, b)| (a - b).abs()));
    assert!(worst <= tolerance && got.sh_coeffs.len() == want.sh_coeffs.len(), "{what}: colours differ by {worst}");
}
