//! The fingerprint.

mod code;
mod film;
