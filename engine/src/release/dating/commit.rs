//! Many receipts under one root: the root's file, and a proof beside each receipt.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::proof::Proof;
use super::root::Root;
use crate::base::digest::Digest;
use crate::base::output::{AtomicFile, Existing};
use crate::error::EngineError;
use crate::release::receipt::Receipt;

/// Writes the root of the receipts at `paths` to `out`, and beside each of them a proof that it is covered.
///
/// # Errors
/// [`EngineError::Usage`] for no receipt and for one that is named twice, which copies are too;
/// [`EngineError::CannotCreate`] where one of the files cannot be written, before any is; those of reading receipts.
pub fn commit(paths: &[PathBuf], out: &Path, existing: Existing) -> Result<Root, EngineError> {
    let mut places: BTreeMap<Digest, PathBuf> = BTreeMap::new();
    for path in paths {
        let commitment = Receipt::read(path)?.commitment;
        if let Some(first) = places.insert(commitment, Proof::beside(path)) {
            return Err(EngineError::Usage {
                what: path.display().to_string(),
                got: format!("the commitment {commitment}, which the receipt beside {} has too", first.display()),
                expected: "each receipt once".to_owned(),
            });
        }
    }
    let root = Root::new(places.keys().copied().collect())?;
    // In the order that was given, so that the first that is in the way is named.
    for target in paths.iter().map(|path| Proof::beside(path)).chain([out.to_owned()]) {
        drop(AtomicFile::create(&target, existing)?);
    }
    // Both are in the order of the commitments.
    for (proof, target) in root.proofs().iter().zip(places.values()) {
        proof.write(target, existing)?;
    }
    // Last, so that a root that is there has all its proofs.
    root.write(out, existing)?;
    Ok(root)
}
