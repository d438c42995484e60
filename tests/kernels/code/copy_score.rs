//! code/copy_score: GPU against the twin, and the twin's stream against another implementation's.

use guard4d_kernels::code::copy_score::{BLOCK_CHIPS, Chips, KEY_WORDS, sum};
use guard4d_kernels::reference::code::copy_score as twin;
use guard4d_kernels::{Buffer, Device, KernelError};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

/// Any words.
fn words(seed: u64, len: usize, below: usize) -> Vec<u32> {
    let mut random = Random(seed);
    (0..len).map(|_| random.below(below) as u32).collect()
}

fn on_gpu(gpu: &Device, keys: &[u32], biases: &[u32], weights: &[f32]) -> Vec<f32> {
    let buffer = |words: &[u32]| gpu.buffer_from("words", words).expect("buffer");
    let (keys, biases) = (buffer(keys), buffer(biases));
    let weights = gpu.buffer_from("weights", weights).expect("buffer");
    let mut scores = gpu.buffer_from("scores", &vec![f32::NAN; keys.len() / KEY_WORDS]).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    sum(&mut rec, &keys, &Chips { biases: &biases, weights: &weights }, &mut scores).expect("records");
    rec.submit().expect("runs");
    scores.read().expect("read")
}

#[test]
fn the_stream_is_that_of_another_implementation() {
    let key = words(1, KEY_WORDS, 1 << 32);
    let mut seed = [0; 32];
    for (bytes, word) in seed.chunks_exact_mut(4).zip(&key) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    let mut rng = ChaCha8Rng::from_seed(seed);
    for block in 0..9 {
        let want: [u32; 16] = std::array::from_fn(|_| rng.next_u32());
        assert_eq!(twin::chacha8(&key, block), want, "block {block}");
    }
}

#[test]
fn gpu_follows_the_twin_at_any_length() {
    let Some(gpu) = device() else { return };
    // Fewer copies than share a load, as many, more; one block of chips and several.
    for (copies, blocks) in [(1, 1), (8, 2), (17, 3), (100, 65)] {
        let chips = blocks * BLOCK_CHIPS;
        let keys = words(copies as u64, copies * KEY_WORDS, 1 << 32);
        // Never and nearly always are among them.
        let mut biases = words(chips as u64, chips, 1 << 16);
        (biases[0], biases[5]) = (0, 65535);
        let weights = Random(7).vec_f32(chips, -1.0, 1.0);
        let want: Vec<f32> = twin::sum(&keys, &biases, &weights.iter().map(|w| f64::from(*w)).collect::<Vec<_>>())
            .into_iter()
            .map(|score| score as f32)
            .collect();
        // At most 32 terms below 1 in a block, and 65 blocks: half a unit in the last place of each sum.
        assert_close(&on_gpu(&gpu, &keys, &biases, &weights), &want, 0.0, 2e-5);
    }
}

#[test]
fn poison_shows_in_the_copies_that_have_the_chip() {
    let Some(gpu) = device() else { return };
    let (copies, chips) = (24, 2 * BLOCK_CHIPS);
    let keys = words(3, copies * KEY_WORDS, 1 << 32);
    let biases = vec![32768; chips];
    let weights = Random(4).vec_f32(chips, -1.0, 1.0);
    let places = [0, 33, 63];
    let by_gpu = |weights: &[f32]| on_gpu(&gpu, &keys, &biases, weights);
    let by_twin = |weights: &[f32]| twin::sum(&keys, &biases, weights);
    let reach = poison::spread(&weights, &places, (1e-6, 1e-5), by_gpu, by_twin);
    assert!(reach.iter().all(|reached| (4..20).contains(reached)), "about half of the copies: {reach:?}");
}

#[test]
fn wrong_lengths_are_refused_and_no_copies_are_fine() {
    let Some(gpu) = device() else { return };
    let keys = gpu.buffer::<u32>("keys", 2 * KEY_WORDS).expect("buffer");
    let whole = gpu.buffer::<u32>("biases", BLOCK_CHIPS).expect("buffer");
    let part = gpu.buffer::<u32>("biases", BLOCK_CHIPS + 4).expect("buffer");
    let weights = gpu.buffer::<f32>("weights", BLOCK_CHIPS).expect("buffer");
    let refused = |biases: &Buffer<u32>, copies, name: &str| {
        let mut scores = gpu.buffer::<f32>("scores", copies).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        let error = sum(&mut rec, &keys, &Chips { biases, weights: &weights }, &mut scores);
        assert!(matches!(&error, Err(KernelError::Shape { buffer, .. }) if *buffer == name), "{name}: {error:?}");
    };
    refused(&whole, 3, "keys");
    refused(&part, 2, "biases");
    refused(&gpu.buffer::<u32>("biases", 0).expect("buffer"), 2, "biases");
    refused(&gpu.buffer::<u32>("biases", 2 * BLOCK_CHIPS).expect("buffer"), 2, "weights");
    assert!(on_gpu(&gpu, &[], &[1; BLOCK_CHIPS], &[1.0; BLOCK_CHIPS]).is_empty());
}
