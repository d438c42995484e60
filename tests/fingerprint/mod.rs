//! The fingerprint.

mod code;
mod fidelity;
mod film;
