//! Exclusive prefix sum.

use crate::error::KernelError;
use crate::registry::scan::{
    prefix_sum_apply, prefix_sum_apply_tile, prefix_sum_partial, prefix_sum_partial_tile, prefix_sum_single,
    prefix_sum_spine,
};
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Device, Grid, KernelFamily, Recorder};

/// Invocations of one workgroup of the lane kernels.
const GROUP: usize = 8;
/// Elements that one lane sums at least, so that starting it pays.
const MIN_CHUNK: usize = 1024;
/// Most elements for which one workgroup of lanes is faster than three passes.
const MAX_SINGLE: usize = 16384;
/// Lanes at most, which the spine walks one after another; of the tile kernels, workgroups.
const MAX_LANES: usize = 512;
/// Texels that a workgroup of the tile kernels sums at once.
const BLOCK_TEXELS: usize = 512;

/// Working memory of [`exclusive`], for any length.
#[derive(Debug)]
pub struct Scratch {
    sums: Buffer<u32>,
}

impl Scratch {
    /// Working memory.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, name: &str) -> Result<Self, KernelError> {
        Ok(Self { sums: device.buffer(&format!("{name}.sums"), MAX_LANES)? })
    }
}

/// Replaces `data[0..n]` by the sums of what stood before each element; `data[n]` becomes the total.
///
/// # Shapes
/// in/out `data` \[> n, rounded up to 4\] (=)
/// # Equation: `data[i] = sum_{j < i} data[j]`, modulo 2³²
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn exclusive(
    rec: &mut Recorder,
    data: &mut Buffer<u32>,
    n: usize,
    scratch: &mut Scratch,
) -> Result<(), KernelError> {
    require_len("scan/prefix_sum", "data", data.len(), (n + 1).next_multiple_of(4))?;
    match rec.family() {
        KernelFamily::Lanes => by_lanes(rec, data, n, scratch),
        KernelFamily::Tiles => by_tiles(rec, data, n, scratch),
    }
}

fn by_lanes(rec: &mut Recorder, data: &mut Buffer<u32>, n: usize, scratch: &mut Scratch) -> Result<(), KernelError> {
    if n <= MAX_SINGLE {
        let params = prefix_sum_single::Params { n: dim(n), chunk: dim((n / 4 + 1).div_ceil(GROUP)) };
        let before = data.alias();
        return rec.dispatch(prefix_sum_single::Bind { before: &before, data }, params, Grid::groups(1, 1, 1));
    }
    let lanes = n.div_ceil(MIN_CHUNK).clamp(GROUP, MAX_LANES).next_multiple_of(GROUP);
    let chunk = (n / 4 + 1).div_ceil(lanes);
    let grid = Grid::threads(lanes);
    let bind = prefix_sum_partial::Bind { before: data, sums: &mut scratch.sums };
    rec.dispatch(bind, prefix_sum_partial::Params { n: dim(n), chunk: dim(chunk) }, grid)?;
    let before = scratch.sums.alias();
    let bind = prefix_sum_spine::Bind { before: &before, sums: &mut scratch.sums };
    rec.dispatch(bind, prefix_sum_spine::Params { lanes: dim(lanes) }, Grid::groups(1, 1, 1))?;
    let before = data.alias();
    let bind = prefix_sum_apply::Bind { starts: &scratch.sums, before: &before, data };
    rec.dispatch(bind, prefix_sum_apply::Params { n: dim(n), chunk: dim(chunk) }, grid)
}

fn by_tiles(rec: &mut Recorder, data: &mut Buffer<u32>, n: usize, scratch: &mut Scratch) -> Result<(), KernelError> {
    let blocks = (n / 4 + 1).div_ceil(BLOCK_TEXELS);
    let chunk_blocks = blocks.div_ceil(MAX_LANES);
    let chunk = dim(chunk_blocks * BLOCK_TEXELS);
    let groups = blocks.div_ceil(chunk_blocks);
    let grid = Grid::groups(dim(groups), 1, 1);
    // Before the only workgroup there is nothing to sum.
    if groups > 1 {
        let bind = prefix_sum_partial_tile::Bind { data, sums: &mut scratch.sums };
        rec.dispatch(bind, prefix_sum_partial_tile::Params { n: dim(n), chunk }, grid)?;
    }
    let bind = prefix_sum_apply_tile::Bind { sums: &scratch.sums, data };
    rec.dispatch(bind, prefix_sum_apply_tile::Params { n: dim(n), chunk }, grid)
}
