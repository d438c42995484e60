//! Cameras: where a scene is looked at from, and the files that say so.

mod cameras;
pub mod capture;
pub mod classes;
pub mod files;
pub mod flight;
pub mod look_at;
pub mod paths;

pub use cameras::{Camera, CameraSet, FrameSize, View};
