//! Rendering of clips, linear in the colours: plan a view once, then blend and differentiate it often.

pub mod deform;
mod plan;
mod renderer;
mod scene_renderer;

pub use guard4d_kernels::shape::OffsetBases;
pub use guard4d_kernels::splat::rasterize::{Frame, FrameMut};
pub use guard4d_kernels::splat::tile_bin::Prune;
pub use plan::FramePlan;
pub use renderer::{Offsets, Renderer};
pub use scene_renderer::{SceneRenderer, render_frames};
