//! Kernel tests, one file per op, in the folders of `glsl/`.

mod optim;
mod scan;
mod splat;
