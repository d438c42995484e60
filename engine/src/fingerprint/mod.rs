//! The fingerprint: a word of signs for each recipient's copy, which tells copies of one asset apart.
//!
//! Nothing here knows the owner's mark (`watermark`).

mod align;
pub mod as_filmed;
pub mod asset;
pub mod chips;
mod cloud;
pub mod code;
mod coverage;
pub mod drawing;
pub mod estimate;
mod exposure;
pub mod fidelity;
pub mod film;
pub mod issue;
mod looks;
mod lowpass;
pub mod power;
mod residual;
pub mod seen;
pub mod shot;
pub mod similarity;
mod studio;
pub mod trace;
