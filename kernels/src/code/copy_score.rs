//! Scores of many copies of a fingerprint.

use crate::error::KernelError;
use crate::registry::code::copy_score_sum;
use crate::shape::{dim, expect_len, require_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "code/copy_score";
/// Words of a copy's key.
pub const KEY_WORDS: usize = 8;
/// Chips that one block of the cipher makes; a code has whole blocks of them.
pub const BLOCK_CHIPS: usize = 32;

/// What the chips of all copies are made and counted by.
#[derive(Debug)]
pub struct Chips<'a> {
    /// `[chips]`, a multiple of [`BLOCK_CHIPS`] and not 0: a chip is +1 where 16 bits of a copy's stream lie below.
    pub biases: &'a Buffer<u32>,
    /// `[chips]`: what a chip of +1 counts; 0 for those that only fill a block.
    pub weights: &'a Buffer<f32>,
}

/// `scores[j]` = sum of the weights of the chips of copy j that are +1.
///
/// # Shapes
/// in `keys` \[copies, 8\], `chips` \[chips\] each · out `scores` \[copies\] (=)
/// # Equation: chip i is +1 where `u16_i < biases[i]`, for the 16-bit halves `u16_i`, low before high, of the words of
/// `ChaCha8` under the copy's key (Bernstein 2008)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn sum(
    rec: &mut Recorder,
    keys: &Buffer<u32>,
    chips: &Chips<'_>,
    scores: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let Chips { biases, weights } = *chips;
    let (copies, len) = (scores.len(), biases.len());
    require_len(KERNEL, "keys", keys.len(), KEY_WORDS * copies)?;
    expect_len(KERNEL, "biases", biases, len.next_multiple_of(BLOCK_CHIPS).max(BLOCK_CHIPS))?;
    expect_len(KERNEL, "weights", weights, len)?;
    let params = copy_score_sum::Params { copies: dim(copies), blocks: dim(len / BLOCK_CHIPS) };
    rec.dispatch(copy_score_sum::Bind { keys, biases, weights, scores }, params, Grid::threads(copies))
}
