//! The fingerprint.

mod code;
