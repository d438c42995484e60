//! Losses.

pub mod bce;
