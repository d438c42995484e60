//! Taking a mark out again, to the original's bytes.
//!
//! Float addition cannot be undone exactly. So the private file of one marked asset holds the exclusive or of the words
//! that colours are stored as, and that of all copies of an issue the original's words of base colours.

use std::path::Path;

use crate::base::files::bad_data;
use crate::base::output::{AtomicDir, AtomicFile, Existing};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::scene::Model;
use crate::scene::gaussians::{CHANNELS, SH_FLOATS};

/// `format` entry of the undo file of one marked asset.
const FORMAT: &str = "guard4d.undo/2";
/// The same of all copies of an issue.
const OF_COPIES: &str = "guard4d.undo-copies/1";
/// How far a base colour is moved, up and down, to see which words hold it: more than a step of any format, and not
/// beyond both ends.
const MOVE: f32 = 0.25;

/// Writes what turns `marked` coefficients back into the model's own.
///
/// # Errors
/// [`EngineError::Io`] naming the file; those of [`Model::words_of`].
pub fn write(path: &Path, model: &Model, marked: &[f32]) -> Result<(), EngineError> {
    let clean = model.words()?;
    let words = clean.iter().zip(model.words_of(marked)?).map(|(clean, marked)| clean ^ marked).collect();
    write_words(path, Existing::Refuse, model, FORMAT, words)
}

/// Writes what turns any copy of `model` that differs in base colours alone back into it.
///
/// # Errors
/// [`EngineError::CannotCreate`] and [`EngineError::Io`] naming the file; those of [`Model::words_of`].
pub fn write_for_copies(path: &Path, existing: Existing, model: &Model) -> Result<(), EngineError> {
    let words = model.words()?;
    let words = of_base_colours(model, &words)?.into_iter().map(|at| words[at]).collect();
    write_words(path, existing, model, OF_COPIES, words)
}

fn write_words(
    path: &Path,
    existing: Existing,
    model: &Model,
    format: &str,
    words: Vec<u32>,
) -> Result<(), EngineError> {
    let mut file = TensorFile { path: path.to_owned(), ..TensorFile::default() };
    file.meta.insert("format".to_owned(), format.to_owned());
    file.meta.insert("original".to_owned(), model.digest().to_string());
    file.tensors.insert("words".to_owned(), Tensor::u32(&[words.len()], words));
    AtomicFile::write_private(path, existing, &file.to_bytes()?)
}

/// Which of the model's `words` hold base colours, whatever those are.
fn of_base_colours(model: &Model, words: &[u32]) -> Result<Vec<usize>, EngineError> {
    let moved = |by: f32| {
        let mut sh_coeffs = model.gaussians.sh_coeffs.clone();
        sh_coeffs.chunks_exact_mut(SH_FLOATS).for_each(|row| row[..CHANNELS].iter_mut().for_each(|dc| *dc += by));
        model.words_of(&sh_coeffs)
    };
    let (up, down) = (moved(MOVE)?, moved(-MOVE)?);
    Ok((0..words.len()).filter(|at| up[*at] != words[*at] || down[*at] != words[*at]).collect())
}

/// Restores the original of the marked model or copy at `model` into the folder `out`.
///
/// # Errors
/// [`EngineError::BadData`] when the undo file belongs to another model; then nothing is written.
pub fn restore(model: &Path, undo: &Path, out: &Path, existing: Existing) -> Result<(), EngineError> {
    let file = TensorFile::read(undo)?;
    let bad = |field: &str, got: String, expected: String| bad_data(undo, field, got, expected);
    let format = file.text("format")?;
    if ![FORMAT, OF_COPIES].contains(&format) {
        return Err(bad("format", format.to_owned(), format!("{FORMAT} or {OF_COPIES}")));
    }
    let marked = Model::open_in_kind(model)?;
    let mut restored = marked.words()?;
    if format == FORMAT {
        let words = file.integers("words", &[restored.len()])?;
        restored.iter_mut().zip(words).for_each(|(stored, word)| *stored ^= word);
    } else {
        let places = of_base_colours(&marked, &restored)?;
        let words = file.integers("words", &[places.len()])?;
        places.into_iter().zip(words).for_each(|(at, word)| restored[at] = *word);
    }
    let expected = file.text("original")?.to_owned();
    let got = marked.digest_with(&restored).to_string();
    if got != expected {
        return Err(bad("original", got, format!("a model whose original hashes to {expected}")));
    }
    let folder = AtomicDir::create(out, existing)?;
    marked.write(folder.path(), &restored)?;
    folder.commit()
}
