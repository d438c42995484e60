//! Twins of `glsl/loss`.

pub mod bce;
pub mod lpips;
pub mod offset_penalty;
pub mod pixel;
pub mod ssim;
pub mod sum;
