//! Copies for recipients: reserved in the ledger, stamped, written, and written down.

use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::ledger::{CopyHash, CopyRecord, Ledger};
use crate::base::digest::Digest;
use crate::base::output::{AtomicDir, AtomicFile, Existing};
use crate::error::EngineError;
use crate::fingerprint::issue::Issue;

/// Copies that are written before the ledger hears of them: what a killed run has to write again.
const AT_ONCE: usize = 16;

/// Where copies go, and as what.
#[derive(Clone, Copy, Debug)]
pub struct CopyFolder<'a> {
    /// The folder that holds a file or folder for each recipient.
    pub out: &'a Path,
    /// The asset's own file or folder.
    pub model: &'a Path,
    /// Whether copies may take the place of what is there.
    pub existing: Existing,
}

impl CopyFolder<'_> {
    /// Where the copy of a recipient goes: a file with the asset's extension, or a folder.
    #[must_use]
    pub fn path_of(&self, recipient: &str) -> PathBuf {
        let extension = self.model.file_name().and_then(|name| name.to_str()).and_then(extension_of);
        match extension.filter(|_| self.model.is_file()) {
            Some(extension) => self.out.join(format!("{recipient}.{extension}")),
            None => self.out.join(recipient),
        }
    }
}

/// All that follows the stem: `compressed.ply` of `guitar.compressed.ply`, `ply` of `take.2.ply`.
fn extension_of(name: &str) -> Option<&str> {
    let (stem, last) = name.rsplit_once('.')?;
    let compressed = stem.rsplit_once('.').filter(|(_, before)| before.eq_ignore_ascii_case("compressed"));
    Some(compressed.map_or(last, |(stem, _)| &name[stem.len() + 1..]))
}

/// A copy that was written.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamped {
    /// As the ledger has it.
    pub record: CopyRecord,
    /// Where it is.
    pub path: PathBuf,
}

/// Writes the copies of `records`, which are reserved in the ledger, and has it know their hashes. `done` is told of
/// each group that the ledger knows.
///
/// # Errors
/// [`EngineError::CannotCreate`] where something is in the way, which is looked at before anything is written;
/// [`EngineError::Io`]; those of the ledger. What was written before is whole, and the ledger knows it.
pub fn stamp_all(
    issue: &Issue<'_>,
    ledger: &mut Ledger,
    records: Vec<CopyRecord>,
    folder: CopyFolder<'_>,
    done: &mut dyn FnMut(&[Stamped]) -> Result<(), EngineError>,
) -> Result<(), EngineError> {
    fs::create_dir_all(folder.out)
        .map_err(|error| EngineError::CannotCreate { path: folder.out.to_path_buf(), reason: error.to_string() })?;
    if folder.existing == Existing::Refuse {
        let taken = records.iter().map(|record| folder.path_of(&record.recipient)).find(|path| path.exists());
        if let Some(path) = taken {
            let reason = "it exists; --overwrite replaces it".to_owned();
            return Err(EngineError::CannotCreate { path, reason });
        }
    }
    for group in records.chunks(AT_ONCE) {
        let written: Vec<Result<Stamped, EngineError>> =
            group.par_iter().map(|record| write(issue, record, folder)).collect();
        let (whole, failed): (Vec<_>, Vec<_>) = written.into_iter().partition(Result::is_ok);
        let whole: Vec<Stamped> = whole.into_iter().flatten().collect();
        let hashes = whole.iter().filter_map(|Stamped { record, .. }| {
            let hash = record.hash?;
            Some(CopyHash { copy: record.copy, hash })
        });
        ledger.stamped(&hashes.collect::<Vec<_>>())?;
        done(&whole)?;
        failed.into_iter().try_for_each(|failed| failed.map(|_| ()))?;
    }
    Ok(())
}

/// Writes one copy, whole or not at all.
fn write(issue: &Issue<'_>, record: &CopyRecord, folder: CopyFolder<'_>) -> Result<Stamped, EngineError> {
    let (model, path) = (issue.model(), folder.path_of(&record.recipient));
    let words = model.words_of(&issue.stamp(record.copy))?;
    let hash = model.digest_with(&words);
    if record.hash.is_some_and(|known| known != hash) {
        return Err(changed(&path, record, hash));
    }
    match folder.model.is_file() {
        true => {
            let file = model.with_words(&words).concat();
            AtomicFile::write(&path, folder.existing, &file)?;
        }
        false => {
            let made = AtomicDir::create(&path, folder.existing)?;
            model.write(made.path(), &words)?;
            made.commit()?;
        }
    }
    Ok(Stamped { record: CopyRecord { hash: Some(hash), ..record.clone() }, path })
}

/// A copy that comes out as another than the ledger knows: another version of the program made that one.
fn changed(path: &Path, record: &CopyRecord, hash: Digest) -> EngineError {
    let known = record.hash.map_or_else(String::new, |known| known.to_string());
    crate::base::files::bad_data(path, format!("hash of copy {}", record.copy), hash, known)
}
