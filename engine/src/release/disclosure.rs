//! What a third party needs to verify one asset, and nothing more.

use std::path::Path;

use super::dating::proof::Proof;
use super::dating::subject::token_beside;
use super::delivery::{EXTRACTOR, RECEIPT};
use super::receipt::Receipt;
use crate::base::files::{bad_data, read_file};
use crate::base::output::{AtomicDir, AtomicFile, Existing};
use crate::error::EngineError;
use crate::watermark::extractor::weights::ExtractorWeights;
use crate::watermark::key::owner_key::Key;

/// Key of the asset in the folder that is handed over.
pub const ASSET_KEY: &str = "asset.key";

/// Writes a folder with the key of the asset that the receipt is about, the receipt, and the extractor and the date
/// beside it.
///
/// The key holds no master secret. With it the mark of this asset can be read and taken out; token table and decoder,
/// which all of an owner's assets share, read no other asset without its rotation and its extractor.
///
/// # Errors
/// [`EngineError::BadData`] for a receipt of another key, of an older version, or with another extractor beside it;
/// those of reading and writing files.
pub fn write(owner: &Key, receipt: &Path, out: &Path, existing: Existing) -> Result<(), EngineError> {
    let read = Receipt::read(receipt)?;
    let promise = &read.body.promise;
    let Some(anchor) = &promise.anchor else {
        let expected = "guard4d.receipt/3, whose asset has a key of its own";
        return Err(bad_data(receipt, "schema", read.schema, expected));
    };
    let key = owner.for_asset(anchor.asset)?;
    if promise.key_id != key.prf().key_id() {
        return Err(bad_data(receipt, "key_id", promise.key_id, format!("{}, the key given", key.prf().key_id())));
    }
    let path = receipt.with_file_name(EXTRACTOR);
    let digest = ExtractorWeights::read(&path, &key)?.digest(&key)?;
    if promise.extractor != Some(digest) {
        return Err(bad_data(&path, "hash", digest, "the one that the receipt commits to"));
    }
    let folder = AtomicDir::create_private(out, existing)?;
    key.write(&folder.path().join(ASSET_KEY), Existing::Refuse)?;
    let hand_over = |from: &Path, to: &Path| {
        let bytes = read_file(from, "a file to hand over")?;
        AtomicFile::write_private(&folder.path().join(to), Existing::Refuse, &bytes)
    };
    let named = Path::new(RECEIPT);
    hand_over(receipt, named)?;
    hand_over(&path, Path::new(EXTRACTOR))?;
    // Its date, where it has one.
    for (from, to) in [(receipt.to_owned(), named.to_owned()), (Proof::beside(receipt), Proof::beside(named))] {
        let token = token_beside(&from);
        if token.is_file() {
            hand_over(&token, &token_beside(&to))?;
        }
    }
    if Proof::beside(receipt).is_file() {
        hand_over(&Proof::beside(receipt), &Proof::beside(named))?;
    }
    folder.commit()
}
