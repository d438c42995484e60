//! Rows of what the kernels make up: CLIP's image tower, embedding steps, whole clips.

pub(crate) mod clip;
pub(crate) mod embed;
pub(crate) mod memory;
mod owner;
pub(crate) mod scaling;
