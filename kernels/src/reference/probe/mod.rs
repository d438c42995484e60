//! Twins of the `probe` kernels.

pub mod mul_add;
