//! `guard4d.proof/1`: that one receipt is under a root, without naming the others.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::tree::{MAX_LEAVES, root_along};
use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::base::json;
use crate::base::output::{AtomicFile, Existing};
use crate::error::EngineError;

/// What the name of a receipt's proof ends with, after the receipt's stem.
const ENDING: &str = "proof.json";

/// Versions of proofs that this program reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ProofSchema {
    /// The first.
    #[serde(rename = "guard4d.proof/1")]
    V1,
}

/// A receipt's place under a root.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Proof {
    schema: ProofSchema,
    commitment: Digest,
    index: u32,
    receipts: u32,
    root: Digest,
    path: Vec<Digest>,
}

impl Proof {
    /// The proof that `commitment` is the leaf `index` below `root`, with the heads beside its way.
    pub(super) fn new(commitment: Digest, index: u32, receipts: u32, root: Digest, path: Vec<Digest>) -> Self {
        Self { schema: ProofSchema::V1, commitment, index, receipts, root, path }
    }

    /// Where the proof of the receipt at `receipt` lies: `receipt.proof.json` beside `receipt.json`.
    #[must_use]
    pub fn beside(receipt: &Path) -> PathBuf {
        receipt.with_extension(ENDING)
    }

    /// Reads a proof and follows it to its root.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], or [`EngineError::BadData`] where it does not end there.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        Self::parse(path, &read_file(path, "a proof written by `guard4d commit`")?)
    }

    /// Parses `json`, which came from `path`, as [`Self::read`] does.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the field.
    pub fn parse(path: &Path, json: &[u8]) -> Result<Self, EngineError> {
        let found: Self = json::parse(path, "proof", json, "a guard4d.proof")?;
        if found.receipts > MAX_LEAVES {
            return Err(bad_data(path, "receipts", found.receipts, format!("at most {MAX_LEAVES}")));
        }
        let (index, receipts) = (u64::from(found.index), u64::from(found.receipts));
        match root_along(&found.commitment, index, receipts, &found.path) {
            Some(root) if root == found.root => Ok(found),
            Some(root) => {
                let expected = format!("{root}, where commitment, index, receipts and path lead");
                Err(bad_data(path, "root", found.root, expected))
            }
            None => {
                let got = format!("{} digests for index {index} of {receipts}", found.path.len());
                Err(bad_data(path, "path", got, "the digests beside the way of a receipt that is there"))
            }
        }
    }

    /// Writes the proof as indented JSON.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if the file exists and may not be replaced; [`EngineError::Io`].
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), EngineError> {
        AtomicFile::write(path, existing, &json::to_file(self))
    }

    /// The receipt's commitment.
    #[must_use]
    pub fn commitment(&self) -> Digest {
        self.commitment
    }

    /// How many receipts are under the root.
    #[must_use]
    pub fn receipts(&self) -> u32 {
        self.receipts
    }

    /// The root.
    #[must_use]
    pub fn root(&self) -> Digest {
        self.root
    }
}
