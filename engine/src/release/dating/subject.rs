//! What a date is put on: a receipt, or the root of many.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use sha2::{Digest as _, Sha256};

use super::proof::Proof;
use super::root::Root;
use crate::base::digest::Digest;
use crate::base::files::read_file;
use crate::base::json;
use crate::error::EngineError;
use crate::release::receipt::Receipt;

/// What the name of a token ends with, after the stem of what is dated.
const ENDING: &str = "tst";

/// A file that can be dated.
#[derive(Clone, Debug)]
pub enum Subject {
    /// A receipt: its commitment is dated.
    Receipt(Box<Receipt>),
    /// A root: it is dated.
    Root(Root),
    /// The proof that a receipt is under a root: the root is dated.
    Proof(Proof),
}

/// What all these files begin with.
#[derive(Deserialize)]
struct Head {
    schema: String,
}

impl Subject {
    /// Reads a receipt, root or proof; its `schema` tells which.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], or [`EngineError::BadData`] for anything else and for files
    /// that were changed.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        let expected = "a guard4d receipt, root or proof";
        let bytes = read_file(path, expected)?;
        let Head { schema } = json::parse(path, "schema", &bytes, expected)?;
        match schema.split('/').next() {
            Some("guard4d.root") => Root::parse(path, &bytes).map(Self::Root),
            Some("guard4d.proof") => Proof::parse(path, &bytes).map(Self::Proof),
            _ => Receipt::read(path).map(|receipt| Self::Receipt(Box::new(receipt))),
        }
    }

    /// The commitment or root that is dated.
    #[must_use]
    pub fn digest(&self) -> Digest {
        match self {
            Self::Receipt(receipt) => receipt.commitment,
            Self::Root(root) => root.root(),
            Self::Proof(proof) => proof.root(),
        }
    }

    /// How many receipts a date of it covers.
    #[must_use]
    pub fn receipts(&self) -> u32 {
        match self {
            Self::Receipt(_) => 1,
            Self::Root(root) => root.receipts(),
            Self::Proof(proof) => proof.receipts(),
        }
    }

    /// Whether it is, or is shown to cover, the receipt with this commitment.
    #[must_use]
    pub fn covers(&self, commitment: &Digest) -> bool {
        match self {
            Self::Receipt(receipt) => receipt.commitment == *commitment,
            Self::Root(root) => root.covers(commitment),
            Self::Proof(proof) => proof.commitment() == *commitment,
        }
    }
}

/// Where the token for the file at `path` lies: `receipt.tst` beside `receipt.json`.
#[must_use]
pub fn token_beside(path: &Path) -> PathBuf {
    path.with_extension(ENDING)
}

/// SHA-256 of the 32 bytes of a commitment or root: what an authority stamps.
#[must_use]
pub fn imprint(digest: &Digest) -> [u8; 32] {
    Sha256::digest(digest.as_bytes()).into()
}
