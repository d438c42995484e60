//! Stable sort of 32-bit keys with 32-bit values.

use std::mem::swap;

use super::prefix_sum;
use crate::error::KernelError;
use crate::registry::scan::{radix_sort_count, radix_sort_scatter};
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Device, Grid, Recorder};

/// Invocations of one workgroup of the lane kernels.
const GROUP: usize = 8;
/// Elements that one lane sorts at least; a lane costs a column of counters.
const MIN_CHUNK: usize = 512;
/// Lanes at most.
const MAX_LANES: usize = 512;
/// Bits of the widest digit.
const MAX_DIGIT_BITS: u32 = 8;

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
        let table = (lanes(capacity) << MAX_DIGIT_BITS) + 4;
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

fn lanes(n: usize) -> usize {
    n.div_ceil(MIN_CHUNK).clamp(GROUP, MAX_LANES).next_multiple_of(GROUP)
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
    let passes = bits.clamp(1, u32::BITS).div_ceil(MAX_DIGIT_BITS);
    let digit_bits = bits.div_ceil(passes);
    for pass in 0..passes {
        one_digit(rec, pairs, n, pass * digit_bits, digit_bits)?;
    }
    Ok(())
}

fn one_digit(
    rec: &mut Recorder,
    pairs: &mut SortPairs,
    n: usize,
    shift: u32,
    digit_bits: u32,
) -> Result<(), KernelError> {
    let lanes = lanes(n);
    let chunk = dim(n.div_ceil(4).div_ceil(lanes));
    let (bins, grid) = (1usize << digit_bits, Grid::threads(lanes));
    let (n, lanes_dim) = (dim(n), dim(lanes));
    let params = radix_sort_count::Params { n, chunk, lanes: lanes_dim, shift };
    let spec = radix_sort_count::Spec { bins: dim(bins) };
    rec.dispatch_spec(radix_sort_count::Bind { keys: &pairs.keys, table: &mut pairs.table }, params, spec, grid)?;
    prefix_sum::exclusive(rec, &mut pairs.table, bins * lanes, &mut pairs.scan)?;
    let bind = radix_sort_scatter::Bind {
        keys: &pairs.keys,
        values: &pairs.values,
        table: &pairs.table,
        sorted_keys: &mut pairs.other_keys,
        sorted_values: &mut pairs.other_values,
    };
    let params = radix_sort_scatter::Params { n, chunk, lanes: lanes_dim, shift };
    rec.dispatch_spec(bind, params, radix_sort_scatter::Spec { bins: dim(bins) }, grid)?;
    swap(&mut pairs.keys, &mut pairs.other_keys);
    swap(&mut pairs.values, &mut pairs.other_values);
    Ok(())
}
