//! Frozen networks that others trained: CLIP, and those that LPIPS compares pictures with.

pub mod clip;
pub mod lpips;
