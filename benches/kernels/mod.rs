//! Rows of the kernels, a file for each folder of `glsl/`.

pub(crate) mod code;
pub(crate) mod image;
pub(crate) mod loss;
pub(crate) mod nn;
pub(crate) mod optim;
pub(crate) mod probe;
pub(crate) mod scan;
pub(crate) mod splat;
