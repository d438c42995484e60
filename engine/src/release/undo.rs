//! Taking a mark out again, to the original's bytes.
//!
//! Float addition cannot be undone exactly, so the private file holds the exclusive or of the words that colours are
//! stored as.

use std::path::Path;

use crate::base::files::bad_data;
use crate::base::output::{AtomicDir, AtomicFile, Existing};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::scene::Model;

/// `format` entry of an undo file.
const FORMAT: &str = "guard4d.undo/2";

/// Writes what turns `marked` coefficients back into the model's own.
///
/// # Errors
/// [`EngineError::Io`] naming the file; those of [`Model::words_of`].
pub fn write(path: &Path, model: &Model, marked: &[f32]) -> Result<(), EngineError> {
    let clean = model.words()?;
    let words: Vec<u32> = clean.iter().zip(model.words_of(marked)?).map(|(clean, marked)| clean ^ marked).collect();
    let mut file = TensorFile { path: path.to_owned(), ..TensorFile::default() };
    file.meta.insert("format".to_owned(), FORMAT.to_owned());
    file.meta.insert("original".to_owned(), model.digest().to_string());
    file.tensors.insert("words".to_owned(), Tensor::u32(&[words.len()], words));
    AtomicFile::write_private(path, Existing::Refuse, &file.to_bytes()?)
}

/// Restores the original of the marked model at `model` into the folder `out`.
///
/// # Errors
/// [`EngineError::BadData`] when the undo file belongs to another model; then nothing is written.
pub fn restore(model: &Path, undo: &Path, out: &Path, existing: Existing) -> Result<(), EngineError> {
    let file = TensorFile::read(undo)?;
    let bad = |field: &str, got: String, expected: String| bad_data(undo, field, got, expected);
    if file.text("format")? != FORMAT {
        return Err(bad("format", file.text("format")?.to_owned(), FORMAT.to_owned()));
    }
    let marked = Model::open_in_kind(model)?;
    let stored = marked.words()?;
    let words = file.integers("words", &[stored.len()])?;
    let restored: Vec<u32> = stored.iter().zip(words).map(|(stored, word)| stored ^ word).collect();
    let expected = file.text("original")?.to_owned();
    let got = marked.digest_with(&restored).to_string();
    if got != expected {
        return Err(bad("original", got, format!("a model whose original hashes to {expected}")));
    }
    let folder = AtomicDir::create(out, existing)?;
    marked.write(folder.path(), &restored)?;
    folder.commit()
}
