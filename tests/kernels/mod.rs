//! Kernel tests, one file per op, in the folders of `glsl/`.

mod bindings;
mod code;
mod cooperation;
mod device_loss;
mod image;
mod loss;
mod memory;
mod nn;
mod optim;
mod pipeline;
mod probe;
mod scan;
mod section;
mod select;
mod splat;
mod validation;
