//! What leaves the house, and what is kept.

mod dating;
mod gate;
pub(crate) mod receipt;
