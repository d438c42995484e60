//! The fingerprint.

mod asset;
mod code;
mod fidelity;
mod film;
mod issue;
mod similarity;
