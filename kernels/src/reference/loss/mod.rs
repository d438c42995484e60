//! Twins of `glsl/loss`.

pub mod bce;
