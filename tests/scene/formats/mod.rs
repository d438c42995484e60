//! Splat files of other tools: read as those tools read them, written back in kind, and refused with a reason.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::{Gaussians, Model, PlyFile};

use crate::support::close::largest;
use crate::support::repo;

mod format;
mod glb;
mod sog;
mod splat;
mod spz;

/// A file that splat-transform has written (`tests/golden/formats/README.md`).
pub(super) fn golden(name: &str) -> std::path::PathBuf {
    repo("tests/golden/formats").join(name)
}

pub(super) fn golden_bytes(name: &str) -> Vec<u8> {
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
    open_by(Model::open, name, bytes)
}

/// Opens bytes as the file `name`, whose copies are to be of its own format.
pub(super) fn open_bytes_in_kind(name: &str, bytes: &[u8]) -> Result<Model, EngineError> {
    open_by(Model::open_in_kind, name, bytes)
}

fn open_by(open: impl Fn(&Path) -> Result<Model, EngineError>, name: &str, bytes: &[u8]) -> Result<Model, EngineError> {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a temporary folder is writable");
    open(&path)
}

/// The coefficients of a model with its DC terms moved up and down by turns.
pub(super) fn moved(model: &Model, by: f32) -> Vec<f32> {
    let mut sh_coeffs = model.gaussians.sh_coeffs.clone();
    for (row, splat) in sh_coeffs.chunks_exact_mut(48).enumerate() {
        for (channel, dc) in splat[..3].iter_mut().enumerate() {
            *dc += if (row + channel).is_multiple_of(2) { by } else { -by };
        }
    }
    sh_coeffs
}

/// Opens the file in kind, moves its base colours, and reads the copy. Fails unless the same words give the same file,
/// the copy is read as it was judged, and nothing but base colours is read otherwise.
///
/// # Shapes
/// out \[N,16,3\]: what was asked for, then what is in the copy
#[track_caller]
pub(super) fn in_kind(name: &str, bytes: &[u8], by: f32) -> [Vec<f32>; 2] {
    let model = open_bytes_in_kind(name, bytes).expect(name);
    assert!(!model.sources()[0].is_imported() && model.warnings.is_empty(), "{name}: {:?}", model.warnings);
    assert_eq!(model.gaussians, open_bytes(name, bytes).expect(name).gaussians, "{name}: read alike");
    assert_eq!(model.with_words(&model.words().expect("they can be read")), [bytes], "{name}: the same words");
    let same = model.words_of(&model.gaussians.sh_coeffs).expect("they fit");
    assert_eq!(model.with_words(&same), [bytes], "{name}: the same colours");
    let asked = moved(&model, by);
    let words = model.words_of(&asked).expect("they fit");
    assert_eq!(words.len(), model.words().expect("they can be read").len(), "{name}: a word for each");
    let copy = open_bytes_in_kind(name, &model.with_words(&words)[0]).expect("a copy");
    let stored = model.as_stored(&asked).expect("they fit");
    assert_eq!(copy.gaussians, Gaussians { sh_coeffs: stored.clone(), ..model.gaussians.clone() }, "{name}: as judged");
    let rest = |coeffs: &[f32]| coeffs.chunks_exact(48).flat_map(|c| c[3..].to_vec()).collect::<Vec<_>>();
    assert_eq!(rest(&stored), rest(&model.gaussians.sh_coeffs), "{name}: SH behind the DC terms");
    [asked, stored]
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
