//! What leaves the house, and what is kept.

mod gate;
pub(crate) mod receipt;
