//! Stable sort of 32-bit keys with 32-bit values.

use std::mem::swap;

use super::prefix_sum;
use crate::error::KernelError;
use crate::registry::scan::{radix_sort_count, radix_sort_count_tile, radix_sort_scatter, radix_sort_scatter_tile};
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Device, Grid, KernelFamily, Recorder};

/// Invocations of one workgroup of the lane kernels.
const GROUP: usize = 8;
/// Elements that one lane sorts at least; a lane costs a column of counters.
const MIN_CHUNK: usize = 512;
/// Lanes at most.
const MAX_LANES: usize = 512;
/// Pairs that a workgroup of the tile kernels sorts, and its invocations.
const TILE_PAIRS: usize = 2048;
const TILE_GROUP: usize = 128;

/// Bits of the widest digit: a lane keeps a counter for each of its values in memory of its own, an invocation of the
/// tile kernels in the little that a workgroup shares.
fn max_digit_bits(family: KernelFamily) -> u32 {
    match family {
        KernelFamily::Lanes => 8,
        KernelFamily::Tiles => 4,
    }
}

/// Pairs to sort, their second copy and the digit counters.
#[derive(Debug)]
pub struct SortPairs {
    /// Keys `[capacity, padded to 4]`.
    pub keys: Buffer<u32>,
    /// Values `[capacity, padded to 4]`.
    pub values: Buffer<u32>,
    other_keys: Buffer<u32>,
    other_values: Buffer<u32>,
    table: Buffer<u32>,
    scan: prefix_sum::Scratch,
}

impl SortPairs {
    /// Room for `capacity` pairs.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, name: &str, capacity: usize) -> Result<Self, KernelError> {
        let padded = capacity.max(1).next_multiple_of(4);
        let family = device.family();
        let table = (columns(family, capacity) << max_digit_bits(family)) + 4;
        let buffer = |what: &str, len| device.buffer(&format!("{name}.{what}"), len);
        Ok(Self {
            keys: buffer("keys", padded)?,
            values: buffer("values", padded)?,
            other_keys: buffer("other_keys", padded)?,
            other_values: buffer("other_values", padded)?,
            table: buffer("table", table)?,
            scan: prefix_sum::Scratch::new(device, name)?,
        })
    }

    /// Pairs that fit.
    #[must_use]
    pub fn capacity(&self) -> usize {
        self.keys.len()
    }

    /// Bytes of device memory.
    #[must_use]
    pub fn bytes(&self) -> usize {
        4 * (4 * self.keys.len() + self.table.len())
    }
}

/// Columns of the table of counters: lanes, or workgroups of the tile kernels.
fn columns(family: KernelFamily, n: usize) -> usize {
    match family {
        KernelFamily::Lanes => n.div_ceil(MIN_CHUNK).clamp(GROUP, MAX_LANES).next_multiple_of(GROUP),
        KernelFamily::Tiles => n.div_ceil(TILE_PAIRS).max(1),
    }
}

/// Sorts the first `n` pairs by the low `bits` of their keys; equal keys keep their order.
///
/// # Shapes
/// in/out `pairs.keys`, `pairs.values` \[>= n\] (=)
/// # Equation: least-significant-digit radix sort; each lane counts and moves one contiguous chunk
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn sort(rec: &mut Recorder, pairs: &mut SortPairs, n: usize, bits: u32) -> Result<(), KernelError> {
    require_len("scan/radix_sort", "keys", pairs.keys.len(), n)?;
    if n == 0 {
        return Ok(());
    }
    let passes = bits.clamp(1, u32::BITS).div_ceil(max_digit_bits(rec.family()));
    let digit_bits = bits.div_ceil(passes);
    for pass in 0..passes {
        one_digit(rec, pairs, n, Digit { shift: pass * digit_bits, bits: digit_bits })?;
        swap(&mut pairs.keys, &mut pairs.other_keys);
        swap(&mut pairs.values, &mut pairs.other_values);
    }
    Ok(())
}

/// Bits of the keys that one pass sorts by.
#[derive(Clone, Copy)]
struct Digit {
    shift: u32,
    bits: u32,
}

fn one_digit(rec: &mut Recorder, pairs: &mut SortPairs, n: usize, digit: Digit) -> Result<(), KernelError> {
    /// Counts, sums and moves with the programs of one family; only the modules that the types come from differ, and
    /// how the work is split.
    macro_rules! one_digit {
        ($count:ident, $scatter:ident, $columns:expr, $grid:expr, { $($split:ident: $value:expr),* }) => {{
            let (columns, grid) = ($columns, $grid);
            let bins = 1usize << digit.bits;
            let bind = $count::Bind { keys: &pairs.keys, table: &mut pairs.table };
            let params = $count::Params { n: dim(n), shift: digit.shift, $($split: $value),* };
            rec.dispatch_spec(bind, params, $count::Spec { bins: dim(bins) }, grid)?;
            prefix_sum::exclusive(rec, &mut pairs.table, bins * columns, &mut pairs.scan)?;
            let bind = $scatter::Bind {
                keys: &pairs.keys,
                values: &pairs.values,
                table: &pairs.table,
                sorted_keys: &mut pairs.other_keys,
                sorted_values: &mut pairs.other_values,
            };
            let params = $scatter::Params { n: dim(n), shift: digit.shift, $($split: $value),* };
            rec.dispatch_spec(bind, params, $scatter::Spec { bins: dim(bins) }, grid)
        }};
    }
    let family = rec.family();
    let columns = columns(family, n);
    match family {
        KernelFamily::Lanes => {
            let chunk = dim(n.div_ceil(4).div_ceil(columns));
            let grid = Grid::threads(columns);
            one_digit!(radix_sort_count, radix_sort_scatter, columns, grid, { chunk: chunk, lanes: dim(columns) })
        }
        KernelFamily::Tiles => {
            let grid = Grid::threads(columns * TILE_GROUP);
            one_digit!(radix_sort_count_tile, radix_sort_scatter_tile, columns, grid, { groups: dim(columns) })
        }
    }
}
