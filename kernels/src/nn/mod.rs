//! Layers of networks.

pub mod conv3d;
