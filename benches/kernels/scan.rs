//! Prefix sum, and the stable sort of pairs that uses it.

use guard4d_kernels::scan::prefix_sum;
use guard4d_kernels::scan::radix_sort::{self, SortPairs};

use crate::harness::{Bench, Outcome, Work};

const PAIRS: usize = 1 << 20;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    // One place more for the total, in whole texels.
    let mut data = bench.device.buffer("data", PAIRS + 4)?;
    let mut scratch = prefix_sum::Scratch::new(&bench.device, "prefix_sum")?;
    let work = Work::Bytes(8.0 * PAIRS as f64, "2·4·n, as if one pass did");
    bench.passes("scan/prefix_sum 1 Mi elements", work, |rec| {
        prefix_sum::exclusive(rec, &mut data, PAIRS, &mut scratch)
    })?;

    // A multiplicative hash: every digit is evenly spread.
    let keys: Vec<u32> = (0..PAIRS as u32).map(|i| i.wrapping_mul(0x9e37_79b9)).collect();
    let unsorted = bench.device.buffer_from("unsorted", &keys)?;
    let mut pairs = SortPairs::new(&bench.device, "pairs", PAIRS)?;
    let work = Work::Bytes(16.0 * PAIRS as f64, "16·n, as if one pass did");
    bench.passes("scan/radix_sort 1 Mi pairs, 32 bits", work, |rec| {
        rec.copy(&unsorted, 0, &mut pairs.keys, 0, PAIRS)?;
        radix_sort::sort(rec, &mut pairs, PAIRS, u32::BITS)
    })
}
