//! Twins of `glsl/optim`.

pub mod adam;
pub mod neighbour_mean;
