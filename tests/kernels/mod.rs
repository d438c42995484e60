//! Kernel tests, one file per op, in the folders of `glsl/`.

mod nn;
mod optim;
