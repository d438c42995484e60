//! What an owner commits to before copies leave the house: the issue's key, the original, and every copy, under a root
//! that a time-stamping authority dates.

use super::dating::root::Root;
use super::ledger::{CopyRecord, Ledger};
use crate::base::digest::Digest;
use crate::base::prf::{Prf, Purpose};
use crate::error::EngineError;

/// The root over the issue and all of its copies that were written. Without the key nobody can tell who got one.
///
/// # Equation
/// Commitments are MACs under the issue's key: of its public name, the original's hash and the strength; and for each
/// copy of its number, hash and recipient.
///
/// # Errors
/// Those of reading the ledger and of [`Root::new`].
pub fn root_of(ledger: &Ledger) -> Result<Root, EngineError> {
    let (prf, terms) = (ledger.prf(), ledger.terms());
    let issue =
        [prf.key_id().to_string().as_bytes(), terms.original.as_bytes(), &terms.strength.to_le_bytes()].concat();
    let written = ledger.copies()?.into_iter().filter_map(|copy| of_copy(&prf, &copy));
    Root::new(std::iter::once(prf.mac(Purpose::Commitments, &issue)).chain(written).collect())
}

fn of_copy(prf: &Prf, record: &CopyRecord) -> Option<Digest> {
    let hash = record.hash?;
    let data = [&record.copy.to_le_bytes(), hash.as_bytes().as_slice(), record.recipient.as_bytes()].concat();
    Some(prf.mac(Purpose::Commitments, &data))
}
