//! Twins of `code`.

pub mod copy_score;
