//! The owner's message: secrets, tokens, evidence and receipts.

pub mod digest;
pub mod evidence;
pub mod message;
pub mod metrics;
pub mod null_panel;
pub mod prf;
pub mod reading;
pub mod receipt;
pub mod statistics;
pub mod tokens;
