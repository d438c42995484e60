//! LPIPS, the distance of pictures as a network's features have it (Zhang et al. 2018), with its gradient.

mod distance;
mod network;
mod pass;
mod weights;

pub use distance::size_of_frame;
pub use guard4d_kernels::image::resize::ImageSize;
pub use network::{Lpips, LpipsInput, LpipsScore, NUM_TAPS};
pub use pass::{LpipsFeatures, LpipsGradient, LpipsPass, Pair, Reference};
pub use weights::{LpipsNet, LpipsWeights};
