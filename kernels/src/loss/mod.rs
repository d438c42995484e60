//! Losses: value and gradient in one go. Values stay on the device, one slot per loss.

pub mod bce;
pub mod lpips;
pub mod offset_penalty;
pub mod pixel;
pub mod ssim;
pub mod sum;
mod term;

pub use term::{PixelPair, Term};
