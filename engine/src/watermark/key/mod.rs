//! The owner's key: a token table and a message decoder, both derived from a master secret.

pub mod capacity;
pub mod decoder;
mod decoder_training;
pub mod key_file;
pub mod owner_key;
pub mod passphrase;
pub mod text_codes;
pub mod tokens;
