//! `guard4d.root/1`: one hash over the commitments of many receipts, and all of these.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::proof::Proof;
use super::tree::{MAX_LEAVES, Tree};
use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::base::json;
use crate::base::output::{AtomicFile, Existing};
use crate::error::EngineError;

/// Versions of root files that this program reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RootSchema {
    /// The first.
    #[serde(rename = "guard4d.root/1")]
    V1,
}

/// A root and what it is made of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Root {
    schema: RootSchema,
    receipts: u32,
    root: Digest,
    commitments: Vec<Digest>,
}

impl Root {
    /// The root of `commitments`, which are put in order.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for none, for more than [`MAX_LEAVES`], and where two are the same.
    pub fn new(mut commitments: Vec<Digest>) -> Result<Self, EngineError> {
        let usage = |got: String, expected: &str| EngineError::Usage {
            what: "receipts".to_owned(),
            got,
            expected: expected.to_owned(),
        };
        commitments.sort_unstable();
        if let Some(twice) = commitments.windows(2).find(|two| two[0] == two[1]) {
            return Err(usage(format!("the commitment {} twice", twice[0]), "each once"));
        }
        let receipts = u32::try_from(commitments.len()).ok().filter(|n| *n <= MAX_LEAVES);
        match receipts.zip(Tree::over(&commitments).map(|tree| tree.root())) {
            Some((receipts, root)) => Ok(Self { schema: RootSchema::V1, receipts, root, commitments }),
            None => Err(usage(commitments.len().to_string(), &format!("1 to {MAX_LEAVES}"))),
        }
    }

    /// Reads a root file and makes the root anew of its commitments.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], or [`EngineError::BadData`] naming the field that does not
    /// fit the commitments.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        Self::parse(path, &read_file(path, "a root written by `guard4d commit`")?)
    }

    /// Parses `json`, which came from `path`, as [`Self::read`] does.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the field.
    pub fn parse(path: &Path, json: &[u8]) -> Result<Self, EngineError> {
        let found: Self = json::parse(path, "root", json, "a guard4d.root")?;
        if let Some(two) = found.commitments.windows(2).find(|two| two[0] >= two[1]) {
            return Err(bad_data(path, "commitments", two[1], format!("one above {}, in order, each once", two[0])));
        }
        if found.commitments.len() != found.receipts as usize || found.receipts > MAX_LEAVES {
            let expected = format!("{}, the number of commitments, at most {MAX_LEAVES}", found.commitments.len());
            return Err(bad_data(path, "receipts", found.receipts, expected));
        }
        match Tree::over(&found.commitments).map(|tree| tree.root()) {
            Some(root) if root == found.root => Ok(found),
            Some(root) => Err(bad_data(path, "root", found.root, format!("{root}, the root of the commitments"))),
            None => Err(bad_data(path, "commitments", "none", "at least one")),
        }
    }

    /// Writes the root as indented JSON.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if the file exists and may not be replaced; [`EngineError::Io`].
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), EngineError> {
        AtomicFile::write(path, existing, &json::to_file(self))
    }

    /// How many receipts it covers.
    #[must_use]
    pub fn receipts(&self) -> u32 {
        self.receipts
    }

    /// The root.
    #[must_use]
    pub fn root(&self) -> Digest {
        self.root
    }

    /// The commitments, in order.
    #[must_use]
    pub fn commitments(&self) -> &[Digest] {
        &self.commitments
    }

    /// Whether a receipt with this commitment is covered.
    #[must_use]
    pub fn covers(&self, commitment: &Digest) -> bool {
        self.commitments.binary_search(commitment).is_ok()
    }

    /// For each of the commitments, in order, a proof that it is covered, which names no other.
    #[must_use]
    pub fn proofs(&self) -> Vec<Proof> {
        let Some(tree) = Tree::over(&self.commitments) else { return Vec::new() };
        let proof = |(index, commitment): (u32, &Digest)| {
            let path = tree.path(index as usize)?;
            Some(Proof::new(*commitment, index, self.receipts, self.root, path))
        };
        (0..).zip(&self.commitments).filter_map(proof).collect()
    }
}
