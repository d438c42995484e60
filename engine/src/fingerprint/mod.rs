//! The fingerprint: a word of signs for each recipient's copy, which tells copies of one asset apart.
//!
//! Nothing here knows the owner's mark (`watermark`).

pub mod chips;
pub mod code;
pub mod estimate;
pub mod fidelity;
pub mod film;
pub mod issue;
pub mod power;
pub mod seen;
pub mod trace;
