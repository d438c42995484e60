//! Words of signs that tell copies of an asset apart.

pub mod copy_score;
