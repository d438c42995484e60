//! The key of an issue as a file on its own: a backup that never grows old, by which the copies of a lost ledger are
//! scored again.

use std::path::Path;

use serde::{Deserialize, Serialize};
use zeroize::Zeroizing;

use super::ledger::Terms;
use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::base::json;
use crate::base::output::{AtomicFile, Existing};
use crate::base::prf::MasterSecret;
use crate::error::EngineError;

const FORMAT: &str = "guard4d.issue/1";

/// The file's entries.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct IssueKey {
    format: String,
    secret: Zeroizing<String>,
    original: Digest,
    splats: u64,
    strength: f64,
    psnr_db: f64,
    receipt: Option<Digest>,
}

/// Writes the terms of an issue, secret included, for their owner's eyes alone.
///
/// # Errors
/// [`EngineError::CannotCreate`] or [`EngineError::Io`] naming the file.
pub fn write(path: &Path, existing: Existing, terms: &Terms) -> Result<(), EngineError> {
    let Terms { secret, original, splats, strength, psnr_db, receipt } = terms.clone();
    let secret = Zeroizing::new(hex::encode(secret.expose()));
    let key = IssueKey { format: FORMAT.to_owned(), secret, original, splats, strength, psnr_db, receipt };
    AtomicFile::write_private(path, existing, &Zeroizing::new(json::to_file(&key)))
}

/// Reads what [`write()`] wrote.
///
/// # Errors
/// [`EngineError::MissingInput`], [`EngineError::Io`]; [`EngineError::BadData`] naming the field.
pub fn read(path: &Path) -> Result<Terms, EngineError> {
    let expected = "the key of an issue, as `guard4d ledger key` writes it";
    let bytes = Zeroizing::new(read_file(path, expected)?);
    let IssueKey { format, secret, original, splats, strength, psnr_db, receipt } =
        json::parse(path, "json", &bytes, expected)?;
    if format != FORMAT {
        return Err(bad_data(path, "format", format, FORMAT));
    }
    for (field, value) in [("strength", strength), ("psnr_db", psnr_db)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(bad_data(path, field, value, "more than 0"));
        }
    }
    let mut bytes = Zeroizing::new([0; 32]);
    // What was found is a secret, and stays out of the message.
    hex::decode_to_slice(secret.as_bytes(), &mut *bytes)
        .map_err(|error| bad_data(path, "secret", error, "64 hexadecimal digits"))?;
    Ok(Terms { secret: MasterSecret::from_bytes(*bytes), original, splats, strength, psnr_db, receipt })
}
