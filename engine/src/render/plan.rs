//! The part of one frame that no colour changes.

use std::sync::Arc;

use guard4d_kernels::Buffer;
use guard4d_kernels::splat::dc_colour::BaseColours;
use guard4d_kernels::splat::sh::VisibleSplats;
use guard4d_kernels::splat::tile_bin::VisibleLists;

use crate::error::EngineError;

/// What a (camera, time) pair sees: visible splats, their tile lists and view directions. Constant while
/// geometry and opacity are frozen.
#[derive(Debug)]
pub struct FramePlan {
    pub(super) lists: VisibleLists,
    /// Unmarked colours before the clamp `[V,4]`, where they took the place of the directions.
    base: Option<Buffer<f32>>,
    pub(super) sh_coeffs: Arc<Buffer<f32>>,
    pub(super) sh_degree: u32,
}

impl FramePlan {
    pub(super) fn new(lists: VisibleLists, sh_coeffs: Arc<Buffer<f32>>, sh_degree: u32) -> Self {
        Self { lists, base: None, sh_coeffs, sh_degree }
    }

    /// Image width in px.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.lists.grid.width
    }

    /// Image height in px.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.lists.grid.height
    }

    /// Floats of one frame `[H,W,4]`.
    #[must_use]
    pub fn frame_len(&self) -> usize {
        4 * self.lists.grid.num_pixels()
    }

    /// Splats that the view sees.
    #[must_use]
    pub fn num_visible(&self) -> usize {
        self.lists.num_visible
    }

    /// Pairs of a tile and a splat.
    #[must_use]
    pub fn num_isects(&self) -> usize {
        self.lists.num_isects
    }

    /// Device bytes held by the plan; the scene's coefficients are shared and not counted.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.lists.bytes() + size_of::<f32>() * self.base.as_ref().map_or(0, Buffer::len)
    }

    /// Rows in the scene of the visible splats, ascending.
    ///
    /// # Errors
    /// When reading back from the device fails.
    pub fn visible_splats(&self) -> Result<Vec<u32>, EngineError> {
        Ok(self.lists.splat_from_visible.read_range(0..self.num_visible())?)
    }

    /// The splats with the directions that they are seen along; without them when only their base colours are kept.
    pub(super) fn visible(&self) -> VisibleSplats<'_> {
        VisibleSplats {
            dirs: &self.lists.dirs,
            splat_from_visible: &self.lists.splat_from_visible,
            count: self.lists.num_visible,
        }
    }

    /// The splats with their unmarked colours, when those are kept.
    pub(super) fn base_colours(&self) -> Option<BaseColours<'_>> {
        let (splat_from_visible, count) = (&self.lists.splat_from_visible, self.lists.num_visible);
        let max_colour = self.lists.rules.max_colour;
        self.base.as_ref().map(|base| BaseColours { base, splat_from_visible, count, max_colour })
    }

    /// Keeps `base` instead of the directions, in whose place `none` comes.
    pub(super) fn keep_base(&mut self, base: Buffer<f32>, none: Buffer<f32>) {
        self.base = Some(base);
        self.lists.dirs = none;
    }
}
