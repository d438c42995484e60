//! What steps draw.

use rand_chacha::ChaCha20Rng;

use crate::base::prf::{Purpose, uniform_below, uniform_unit};
use crate::watermark::key::owner_key::Key;

/// The clip that a step is taken on, by its number among so many, and the stream of all else that the step draws.
pub(super) fn draw(key: &Key, seed: u64, step: usize, clips: usize) -> (usize, ChaCha20Rng) {
    let mut rng = key.prf().stream(Purpose::Embedding, stream_index(seed, step));
    let index = uniform_below(&mut rng, u32::try_from(clips).unwrap_or(u32::MAX));
    (index as usize, rng)
}

/// Every step has a random stream of its own, so that a resumed run draws what an unbroken one would.
fn stream_index(seed: u64, step: usize) -> u64 {
    (seed << 32) | step as u64
}

/// From 0 to 1.
#[allow(clippy::cast_possible_truncation, reason = "a factor between 0 and 1")]
pub(super) fn unit(rng: &mut ChaCha20Rng) -> f32 {
    uniform_unit(rng) as f32
}
