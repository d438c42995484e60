//! The owner's mark (Guard4D): key, extractor, embedding.

pub mod embed;
pub mod extractor;
pub mod key;
pub mod step_part;
