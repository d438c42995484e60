//! CLIP (Radford et al. 2021): image and text towers with frozen weights.

mod config;
mod encoder;
mod layer;
mod model;
mod text;
mod vision;
mod weights;

pub use config::{ClipConfig, TextConfig, VisionConfig};
pub use guard4d_kernels::nn::pack::Precision;
pub use layer::TowerPurpose;
pub use model::{ClipModel, ClipSource};
pub use text::{TextFeatures, TextTower};
pub use vision::{VisionTower, VisionWorkspace};
