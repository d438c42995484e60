//! The owner's message: secrets, tokens, embedding, evidence and receipts.

pub mod calibration;
pub mod capacity;
pub mod cross_examination;
pub mod decoder;
mod decoder_training;
pub mod delivery;
pub mod digest;
pub mod embed;
pub mod evaluate;
pub mod evidence;
pub mod extractor;
pub mod gate;
pub mod id_code;
pub mod key;
pub mod message;
pub mod metrics;
pub mod null_panel;
pub mod other_keys;
pub mod prf;
pub mod reading;
pub mod receipt;
pub mod statistics;
pub mod tmsd;
pub mod tokens;
pub mod undo;
pub mod verify;
