//! Twins of `glsl/optim`.

pub mod adam;
