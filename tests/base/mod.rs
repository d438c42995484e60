//! The ground floor: outputs and streams.

mod held;
mod ledger;
mod output;
mod prf;
mod signature;
mod spread;
