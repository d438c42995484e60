//! The ground floor: outputs and streams.

mod ledger;
mod output;
mod prf;
mod signature;
