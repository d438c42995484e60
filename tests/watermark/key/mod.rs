//! The owner's key and what it is made of.

pub(crate) mod decoder;
pub(crate) mod owner_key;
mod passphrase;
mod tokens;
