//! Scenes: Gaussians, their deformation, cameras, and the files that hold them.

pub mod axes;
pub mod camera;
pub mod cfg_args;
mod content;
pub mod deformation;
pub mod demo;
pub mod ellipsoid;
mod folder;
pub mod formats;
pub mod gaussians;
pub mod limits;
mod literal;
pub mod model;
pub mod motion;
pub mod ply;
pub mod procedural;
pub mod pth;
pub mod recognise;
mod sequence;
pub mod source;
pub mod trajectories;
pub mod warp;

pub use camera::look_at::LookAt;
pub use camera::{Camera, CameraSet, FrameSize, View};
pub use cfg_args::DeformConfig;
pub use deformation::DeformationWeights;
pub use gaussians::Gaussians;
pub use model::Model;
pub use motion::Motion;
pub use ply::PlyFile;
pub use source::SplatSource;
