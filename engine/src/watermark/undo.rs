//! Taking a mark out again, to the original's bytes.
//!
//! Float addition cannot be undone exactly, so the private file holds the exclusive or of the stored words.

use std::path::Path;

use super::digest::Digest;
use crate::error::EngineError;
use crate::output::{AtomicDir, Existing};
use crate::scene::Model;
use crate::tensor_file::{Tensor, TensorFile};

/// `format` entry of an undo file.
const FORMAT: &str = "guard4d.undo/1";

/// Writes what turns `marked` coefficients back into the model's own.
///
/// # Errors
/// [`EngineError::Io`] naming the file.
pub fn write(path: &Path, model: &Model, marked: &[f32]) -> Result<(), EngineError> {
    let clean = &model.gaussians.sh_coeffs;
    let words = clean.iter().zip(marked).map(|(h, m)| h.to_bits() ^ m.to_bits()).collect();
    let mut file = TensorFile { path: path.to_owned(), ..TensorFile::default() };
    file.meta.insert("format".to_owned(), FORMAT.to_owned());
    file.meta.insert("original".to_owned(), Digest::of(model.ply().bytes()).to_string());
    file.tensors.insert("words".to_owned(), Tensor::u32(&[clean.len()], words));
    crate::output::AtomicFile::write(path, Existing::Refuse, &file.to_bytes()?)
}

/// Restores the original of the marked model at `model` into the folder `out`.
///
/// # Errors
/// [`EngineError::BadData`] when the undo file belongs to another model; then nothing is written.
pub fn restore(model: &Path, undo: &Path, out: &Path, existing: Existing) -> Result<(), EngineError> {
    let file = TensorFile::read(undo)?;
    let bad = |field: &str, got: String, expected: String| EngineError::BadData {
        path: undo.to_owned(),
        field: field.to_owned(),
        got,
        expected,
    };
    if file.text("format")? != FORMAT {
        return Err(bad("format", file.text("format")?.to_owned(), FORMAT.to_owned()));
    }
    let marked = Model::open(model)?;
    let words = file.integers("words", &[marked.gaussians.sh_coeffs.len()])?;
    let restored: Vec<f32> =
        marked.gaussians.sh_coeffs.iter().zip(words).map(|(m, word)| f32::from_bits(m.to_bits() ^ word)).collect();
    let expected = file.text("original")?.to_owned();
    let not_ours = |got: String| bad("original", got, format!("a model whose original hashes to {expected}"));
    // Words of another model can make non-finite coefficients, which the PLY writer refuses.
    let ply = marked.ply().with_sh(&restored).map_err(|e| not_ours(e.to_string()))?;
    let got = Digest::of(&ply).to_string();
    if got != expected {
        return Err(not_ours(got));
    }
    let folder = AtomicDir::create(out, existing)?;
    marked.write_marked(folder.path(), &restored)?;
    folder.commit()
}
