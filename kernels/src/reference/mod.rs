//! CPU twins of the kernels: plain loops in the paper's order, generic over `f32` and `f64`.

pub mod code;
pub mod image;
pub mod loss;
pub mod nn;
pub mod optim;
pub mod probe;
mod real;
pub mod scan;
pub mod splat;

pub use real::Real;
