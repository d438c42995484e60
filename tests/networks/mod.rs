//! Frozen networks against those who made them.

pub(crate) mod clip;
mod lpips;
