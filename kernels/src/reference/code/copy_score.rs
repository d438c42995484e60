//! Twin of `code/copy_score`.

use crate::reference::real::Real;

/// Chips of a block of the cipher.
const BLOCK_CHIPS: usize = 32;

/// Sum of the weights of the chips that are +1, of each copy: `keys` `[copies, 8]`, `biases` and `weights` `[chips]` →
/// `[copies]`.
pub fn sum<R: Real>(keys: &[u32], biases: &[u32], weights: &[R]) -> Vec<R> {
    let of_copy = |key: &[u32]| {
        let halves = (0u32..).flat_map(|block| chacha8(key, block)).flat_map(|word| [word & 0xffff, word >> 16]);
        let mut score = R::default();
        for (chip, half) in halves.take(biases.len()).enumerate() {
            if half < biases[chip] {
                score += weights[chip];
            }
        }
        score
    };
    assert!(biases.len().is_multiple_of(BLOCK_CHIPS), "whole blocks");
    keys.chunks_exact(8).map(of_copy).collect()
}

/// Block number `block` of the key's stream (Bernstein 2008, with eight rounds and a counter of 64 bits).
pub fn chacha8(key: &[u32], block: u32) -> [u32; 16] {
    let mut start = [0; 16];
    // "expand 32-byte k"
    start[..4].copy_from_slice(&[0x6170_7865, 0x3320_646e, 0x7962_2d32, 0x6b20_6574]);
    start[4..12].copy_from_slice(key);
    start[12] = block;
    let mut state = start;
    for _ in 0..4 {
        for i in 0..4 {
            quarter_round(&mut state, [i, 4 + i, 8 + i, 12 + i]);
        }
        for i in 0..4 {
            quarter_round(&mut state, [i, 4 + (i + 1) % 4, 8 + (i + 2) % 4, 12 + (i + 3) % 4]);
        }
    }
    std::array::from_fn(|i| state[i].wrapping_add(start[i]))
}

fn quarter_round(state: &mut [u32; 16], [a, b, c, d]: [usize; 4]) {
    for [left, right] in [[16, 12], [8, 7]] {
        state[a] = state[a].wrapping_add(state[b]);
        state[d] = (state[d] ^ state[a]).rotate_left(left);
        state[c] = state[c].wrapping_add(state[d]);
        state[b] = (state[b] ^ state[c]).rotate_left(right);
    }
}
