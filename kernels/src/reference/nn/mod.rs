//! Twins of `nn`.

pub mod conv3d;
