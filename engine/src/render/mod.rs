//! Rendering of clips, linear in the colours: plan a view once, then blend and differentiate it often.

pub mod deform;
pub mod making;
mod plan;
pub mod profile;
mod renderer;
mod scene_renderer;
pub mod settings;
pub mod storage;

pub use guard4d_kernels::shape::OffsetBases;
pub use guard4d_kernels::splat::rasterize::{Frame, FrameMut};
pub use guard4d_kernels::splat::rules::{Extent, Opacity, Rules, SortKey, Stop};
pub use guard4d_kernels::splat::tile_bin::Prune;
pub use plan::FramePlan;
pub use renderer::{Offsets, Renderer};
pub use scene_renderer::{SceneRenderer, render_frames};
