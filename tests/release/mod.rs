//! What leaves the house, and what is kept.

mod dating;
mod gate;
mod ledger;
pub(crate) mod receipt;
mod recipients;
