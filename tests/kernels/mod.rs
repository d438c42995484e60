//! Kernel tests, one file per op, in the folders of `glsl/`.

mod image;
mod loss;
mod nn;
mod optim;
mod probe;
mod scan;
mod select;
mod splat;
