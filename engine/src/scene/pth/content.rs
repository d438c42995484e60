//! What a `.pth` file holds at its root, and what is done against files that mean harm.
//!
//! A `.pth` file is a ZIP archive of a pickle program and raw storages. Python would execute that program; this
//! reader walks it with an allow-list of opcodes and globals and refuses everything else. What an attacker could
//! still spend is memory and time, so every size comes from the file's real length:
//!
//! - archive entries must be stored uncompressed, inside the file, with the right checksum;
//! - the pickle is capped in bytes and opcodes, its strings are borrowed, and its containers live in an arena that
//!   the memo shares, so doubling chains cost nothing and nothing recurses;
//! - a tensor may not be larger than its storage, nor all tensors together than the file.

use std::path::Path;

use super::archive::Archive;
use super::flaw::Flaw;
use super::pickle::{Machine, Root};
use super::tensor;
use super::values::Tensor;
use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;

/// Largest pickle program; a state dict of 49 tensors needs about 8 KiB.
const MAX_PICKLE_BYTES: usize = 16 << 20;

/// What a `.pth` file holds at its root.
#[derive(Clone, Debug, PartialEq)]
pub enum PthContent {
    /// Named tensors, in file order.
    StateDict(Vec<(String, Tensor)>),
    /// A bare tensor.
    Tensor(Tensor),
}

impl PthContent {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], and those of [`PthContent::parse`].
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        Self::parse(path, &read_file(path, "a torch .pth file")?)
    }

    /// Decodes `bytes`, which came from `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the archive entry, the byte of the pickle or the tensor that is wrong.
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self, EngineError> {
        let refuse = |flaw: Flaw| bad_data(path, flaw.field, flaw.got, flaw.expected);
        let archive = Archive::open(bytes).map_err(refuse)?;
        let program = archive.pickle().map_err(refuse)?;
        if program.len() > MAX_PICKLE_BYTES {
            let got = format!("{} bytes", program.len());
            let expected = format!("at most {MAX_PICKLE_BYTES}");
            return Err(bad_data(path, "data.pkl", got, expected));
        }
        let mut reader = tensor::Reader::new(&archive, bytes.len());
        match Machine::run(program).map_err(refuse)? {
            Root::Tensor(view) => {
                let tensor = reader.read("tensor", &view).map_err(refuse)?;
                Ok(Self::Tensor(tensor))
            }
            Root::StateDict(views) => {
                let mut tensors = Vec::with_capacity(views.len());
                for (name, view) in views {
                    let tensor = reader.read(name, &view).map_err(refuse)?;
                    tensors.push((name.to_owned(), tensor));
                }
                Ok(Self::StateDict(tensors))
            }
        }
    }
}
