//! Twin of `image/noise`.

use super::range::{clamp, gate};
use crate::reference::real::Real;

/// PCG4D, Jarzynski & Olano 2020.
pub fn pcg4d(v: [u32; 4]) -> [u32; 4] {
    let mut v = v.map(|c| c.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    let mix = |v: &mut [u32; 4]| {
        for (to, a, b) in [(0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2)] {
            v[to] = v[to].wrapping_add(v[a].wrapping_mul(v[b]));
        }
    };
    mix(&mut v);
    v = v.map(|c| c ^ (c >> 16));
    mix(&mut v);
    v
}

/// Three standard normal values of a counter.
pub fn gaussian<R: Real>(index: u32, stream: u32, seed: u64) -> [R; 3] {
    let halves = [seed & 0xffff_ffff, seed >> 32].map(|h| u32::try_from(h).unwrap_or_default());
    let u = pcg4d([index, stream, halves[0], halves[1]]).map(|bits| (f64::from(bits >> 8) + 0.5) / 16_777_216.0);
    let turn = std::f64::consts::TAU;
    let radius = [u[0], u[2]].map(|u| (-2.0 * u.ln()).sqrt());
    [radius[0] * (turn * u[1]).cos(), radius[0] * (turn * u[1]).sin(), radius[1] * (turn * u[3]).cos()].map(R::of)
}

/// x + σ·z of every colour before the clamp, with the pixel it belongs to.
fn noisy<R: Real>(sigma: R, stream: u32, seed: u64, x: &[R]) -> impl Iterator<Item = [R; 4]> {
    x.chunks_exact(4).zip(0u32..).map(move |(v, i)| {
        let z = gaussian::<R>(i, stream, seed);
        [v[0] + sigma * z[0], v[1] + sigma * z[1], v[2] + sigma * z[2], v[3]]
    })
}

/// Noisy and clamped colours of `[n,4]`; the fourth channel is copied.
pub fn forward<R: Real>(sigma: R, stream: u32, seed: u64, x: &[R]) -> Vec<R> {
    noisy(sigma, stream, seed, x).flat_map(|v| [clamp(v[0]), clamp(v[1]), clamp(v[2]), v[3]]).collect()
}

/// Gradient to x, fourth channel 0.
pub fn backward<R: Real>(sigma: R, stream: u32, seed: u64, x: &[R], v_y: &[R]) -> Vec<R> {
    let pixels = noisy(sigma, stream, seed, x).zip(v_y.chunks_exact(4));
    pixels.flat_map(|(x, v)| [gate(x[0], v[0]), gate(x[1], v[1]), gate(x[2], v[2]), R::of(0.0)]).collect()
}
