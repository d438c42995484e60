//! Scores of a fingerprint's copies.

use guard4d_kernels::code::copy_score::{self, Chips, KEY_WORDS};

use crate::harness::{Bench, Outcome, Work};

/// Copies of a row, of the million that an asset may have.
const COPIES: usize = 1 << 13;
/// Positions of a code: splats and cells of an asset of some size.
const CHIPS: usize = 49_152;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let copies = bench.size(COPIES, 64);
    // A multiplicative hash: as good as any key, and every bias occurs.
    let hashes = |len: usize| (0..len as u32).map(|i| i.wrapping_mul(0x9e37_79b9)).collect::<Vec<_>>();
    let keys = bench.device.buffer_from("keys", &hashes(copies * KEY_WORDS))?;
    let biases: Vec<u32> = hashes(CHIPS).into_iter().map(|word| word >> 16).collect();
    let biases = bench.device.buffer_from("biases", &biases)?;
    let weights = bench.data("weights", CHIPS)?;
    let mut scores = bench.device.buffer("scores", copies)?;
    let chips = Chips { biases: &biases, weights: &weights };
    bench.passes(&format!("code/copy_score {COPIES} copies of {CHIPS} chips"), Work::Mixed, |rec| {
        copy_score::sum(rec, &keys, &chips, &mut scores)
    })
}
