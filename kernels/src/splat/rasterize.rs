//! Front-to-back blending of sorted splats and its gradient with respect to the colours.

use super::rules::{Framebuffer, Stop};
use super::tile_bin::VisibleLists;
use super::tile_grid::{TILE, TileGrid, pixel_workgroups, stride, workgroups};
use crate::error::KernelError;
use crate::registry::splat::{
    rasterize_bwd, rasterize_bwd_tile, rasterize_bytes, rasterize_clear, rasterize_fwd, rasterize_fwd_tile,
    rasterize_gather,
};
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Device, Grid, KernelFamily, Recorder};

const KERNEL: &str = "splat/rasterize";

/// Workgroups along x that every device takes; more may spill into y and leave some over.
const GROUPS_IN_ROW: usize = 65_535;

/// A view of one frame of a clip `[F,H,W,4]`.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// The clip.
    pub clip: &'a Buffer<f32>,
    /// Frame index.
    pub index: usize,
}

/// One frame of a clip `[F,H,W,4]` to write.
#[derive(Debug)]
pub struct FrameMut<'a> {
    /// The clip.
    pub clip: &'a mut Buffer<f32>,
    /// Frame index.
    pub index: usize,
}

/// Working memory of [`backward`].
#[derive(Debug)]
pub struct BackwardScratch {
    v_slots: Buffer<f32>,
}

impl BackwardScratch {
    /// Room for lists of `num_isects` pairs.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, num_isects: usize) -> Result<Self, KernelError> {
        Ok(Self { v_slots: device.buffer("rasterize.v_slots", 4 * num_isects)? })
    }

    /// Pairs that fit.
    #[must_use]
    pub fn capacity(&self) -> usize {
        self.v_slots.len() / 4
    }
}

/// Blends the visible splats into one frame of a clip. Linear in the colours, whatever framebuffer the rules name.
///
/// # Shapes
/// in `lists` · `colours` \[V,4\] · out `frame` \[H,W,4\] (=): rgb over the background, final transmittance
/// # Equation
/// Kerbl et al. 2023 unless the lists' rules say otherwise: alpha at most 0.99, skipped below 1/255; a pixel stops
/// before the splat that would bring its transmittance below 1e-4. No clamp of the result.
/// # Determinism: bitwise; no atomics
/// # Cost
/// About 26·64 operations per pair, and 52 bytes read once (lanes: by eight invocations; tiles: by one, then 64 times
/// from shared memory).
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    lists: &VisibleLists,
    colours: &Buffer<f32>,
    background: [f32; 3],
    frame: FrameMut<'_>,
) -> Result<(), KernelError> {
    blend_into(Framebuffer::Floats, rec, lists, colours, background, frame)
}

/// The same into a framebuffer of 8 bits a channel, back to front: each splat is rounded to steps of 1/255, halves up,
/// and what leaves 0 to 1 is cut off.
///
/// # Shapes
/// As [`forward`]
/// # Equation
/// `c ← ⌊255 (min(alpha colour, 1) + (1 − alpha) c) + ½⌋ / 255` from the last splat to the first; no pixel stops.
/// # Determinism: bitwise; no atomics
/// # Cost
/// About 40·64 operations per pair, and 52 bytes read by eight invocations.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward_in_bytes(
    rec: &mut Recorder,
    lists: &VisibleLists,
    colours: &Buffer<f32>,
    background: [f32; 3],
    frame: FrameMut<'_>,
) -> Result<(), KernelError> {
    blend_into(Framebuffer::Bytes, rec, lists, colours, background, frame)
}

fn blend_into(
    framebuffer: Framebuffer,
    rec: &mut Recorder,
    lists: &VisibleLists,
    colours: &Buffer<f32>,
    background: [f32; 3],
    frame: FrameMut<'_>,
) -> Result<(), KernelError> {
    let (grid, rules) = (lists.grid, lists.rules);
    require_len(KERNEL, "colours", colours.len(), 4 * lists.num_visible)?;
    require_len(KERNEL, "clip", frame.clip.len(), 4 * grid.num_pixels() * (frame.index + 1))?;
    /// Binds and runs one program; beside the module that the types come from, only the named parameters differ.
    macro_rules! blend {
        ($module:ident, $grid:expr, $spec:expr $(, $parameter:ident)*) => {{
            let bind = $module::Bind {
                geom: &lists.geom,
                colours,
                splat_from_isect: &lists.splat_from_isect,
                tile_offsets: &lists.tile_offsets,
                tile_order: &lists.tile_order,
                image: &mut *frame.clip,
            };
            let params = $module::Params {
                width: grid.width,
                height: grid.height,
                tiles_x: grid.tiles_x(),
                num_active: dim(lists.num_active),
                tile_stride: stride(lists.num_active),
                out_offset: dim(grid.num_pixels() * frame.index),
                background_r: background[0],
                background_g: background[1],
                background_b: background[2],
                min_alpha: rules.min_alpha,
                max_alpha: rules.max_alpha,
                span: rules.span(),
                foot: rules.foot,
                $($parameter,)*
            };
            rec.dispatch_spec(bind, params, $spec, $grid)
        }};
    }
    let (packed, plain) = (u32::from(lists.is_packed()), rules.plain());
    let behind = u32::from(rules.stop == Stop::Behind);
    let columns = workgroups(lists.num_active);
    match (framebuffer, rec.family()) {
        (Framebuffer::Bytes, _) => {
            blend!(rasterize_bytes, columns, rasterize_bytes::Spec { packed, plain })?;
            let stored = |channel: f32| (255.0 * channel.clamp(0.0, 1.0) + 0.5).floor() / 255.0;
            return clear(rec, lists, background.map(stored), frame);
        }
        (Framebuffer::Floats, KernelFamily::Lanes) => {
            let spec = rasterize_fwd::Spec { whole: u32::from(is_whole(lists)), packed, plain };
            blend!(rasterize_fwd, columns, spec, behind)?;
        }
        (Framebuffer::Floats, KernelFamily::Tiles) => {
            let spec = rasterize_fwd_tile::Spec { packed, plain };
            blend!(rasterize_fwd_tile, pixel_workgroups(lists.num_active), spec, behind)?;
        }
    }
    clear(rec, lists, background, frame)
}

/// Fills the tiles without pairs.
fn clear(
    rec: &mut Recorder,
    lists: &VisibleLists,
    background: [f32; 3],
    frame: FrameMut<'_>,
) -> Result<(), KernelError> {
    let grid = lists.grid;
    let params = rasterize_clear::Params {
        width: grid.width,
        height: grid.height,
        tiles_x: grid.tiles_x(),
        num_active: dim(lists.num_active),
        num_tiles: grid.num_tiles(),
        out_offset: dim(grid.num_pixels() * frame.index),
        background_r: background[0],
        background_g: background[1],
        background_b: background[2],
    };
    let bind = rasterize_clear::Bind { tile_order: &lists.tile_order, image: frame.clip };
    rec.dispatch(bind, params, workgroups(grid.num_tiles() as usize - lists.num_active))
}

/// Gradient with respect to the colours: the same traversal, then a sum over each splat's tiles.
///
/// # Shapes
/// in `lists` · `v_frame` \[H,W,4\], fourth channel unread · out `v_colours` \[V,4\] (=), fourth channel 0
/// # Equation: `v_colour_i = sum_p alpha_pi T_pi v_image_p`; geometry and opacity are constants
/// # Determinism: bitwise; every pair has its own slot and slots are added in a fixed order
/// # Cost
/// About 26·64 operations per pair, 40 bytes read and 16 written, and 16 read again by the sum over slots.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    lists: &VisibleLists,
    v_frame: Frame<'_>,
    scratch: &mut BackwardScratch,
    v_colours: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let (grid, rules) = (lists.grid, lists.rules);
    require_len(KERNEL, "v_colours", v_colours.len(), 4 * lists.num_visible)?;
    require_len(KERNEL, "v_clip", v_frame.clip.len(), 4 * grid.num_pixels() * (v_frame.index + 1))?;
    require_len(KERNEL, "v_slots", scratch.v_slots.len(), 4 * lists.num_isects)?;
    /// As in `blend_into`.
    macro_rules! pull {
        ($module:ident, $grid:expr) => {{
            let bind = $module::Bind {
                geom: &lists.geom,
                v_image: v_frame.clip,
                splat_from_isect: &lists.splat_from_isect,
                slot_from_isect: &lists.slot_from_isect,
                tile_offsets: &lists.tile_offsets,
                tile_order: &lists.tile_order,
                slot_ranges: &lists.slot_ranges,
                v_slots: &mut scratch.v_slots,
            };
            let params = $module::Params {
                width: grid.width,
                height: grid.height,
                tiles_x: grid.tiles_x(),
                num_active: dim(lists.num_active),
                tile_stride: stride(lists.num_active),
                in_offset: dim(grid.num_pixels() * v_frame.index),
                min_alpha: rules.min_alpha,
                max_alpha: rules.max_alpha,
                span: rules.span(),
                foot: rules.foot,
                behind: u32::from(rules.stop == Stop::Behind),
            };
            let spec = $module::Spec { packed: u32::from(lists.is_packed()), plain: rules.plain() };
            rec.dispatch_spec(bind, params, spec, $grid)
        }};
    }
    match rec.family() {
        KernelFamily::Lanes => pull!(rasterize_bwd, workgroups(lists.num_active))?,
        KernelFamily::Tiles => pull!(rasterize_bwd_tile, pixel_workgroups(lists.num_active))?,
    }
    let bind = rasterize_gather::Bind { v_slots: &scratch.v_slots, slot_ranges: &lists.slot_ranges, v_colours };
    let params = rasterize_gather::Params { num_visible: dim(lists.num_visible), num_slots: dim(lists.num_isects) };
    rec.dispatch(bind, params, Grid::threads(lists.num_visible))
}

/// Whether tiles cover the image exactly and workgroups the tiles, so that no store needs a mask.
fn is_whole(lists: &VisibleLists) -> bool {
    let TileGrid { width, height } = lists.grid;
    width.is_multiple_of(TILE) && height.is_multiple_of(TILE) && lists.num_active <= GROUPS_IN_ROW
}
