//! Twin of `splat/hexplane_fwd`.

use crate::reference::real::Real;

/// One plane `[C, height, width]`; the first coordinate of its pair runs along the width.
#[derive(Clone, Debug)]
pub struct Plane<R> {
    /// Values, channel-major.
    pub data: Vec<R>,
    /// Samples along the first coordinate.
    pub width: usize,
    /// Samples along the second coordinate.
    pub height: usize,
}

/// Pairs of coordinates (x, y, z, t) of the six planes of a level.
const PAIRS: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];

/// Index of the lower neighbour and fraction: corners aligned, border outside.
fn position<R: Real>(q: R, size: usize) -> (usize, R) {
    let last = R::of((size - 1) as f64);
    let at = (R::of(0.5) * (q + R::of(1.0)) * last).max(R::of(0.0)).min(last);
    let low = (0..size.saturating_sub(1)).rev().find(|&i| R::of(i as f64) <= at).unwrap_or(0);
    (low, at - R::of(low as f64))
}

fn sample<R: Real>(plane: &Plane<R>, q: [R; 2], channel: usize) -> R {
    let ((x, fx), (y, fy)) = (position(q[0], plane.width), position(q[1], plane.height));
    let (right, below) = ((x + 1).min(plane.width - 1), (y + 1).min(plane.height - 1));
    let at = |x: usize, y: usize| plane.data[(channel * plane.height + y) * plane.width + x];
    let mix = |a: R, b: R, f: R| a * (R::of(1.0) - f) + b * f;
    mix(mix(at(x, y), at(right, y), fx), mix(at(x, below), at(right, below), fx), fy)
}

/// Features `[N, levels * channels]` of `means` `[N,4]` at `time`: per level the product over its six
/// planes of the bilinear samples (Cao & Johnson 2023); positions are normalised by `aabb` in the
/// order it is stored, the time is not.
#[must_use]
pub fn forward<R: Real>(planes: &[Plane<R>], channels: usize, aabb: &[[R; 3]; 2], means: &[R], time: R) -> Vec<R> {
    let mut features = Vec::new();
    for mean in means.chunks_exact(4) {
        let axis = |k: usize| (mean[k] - aabb[0][k]) * R::of(2.0) / (aabb[1][k] - aabb[0][k]) - R::of(1.0);
        let q = [axis(0), axis(1), axis(2), time];
        for level in planes.chunks_exact(PAIRS.len()) {
            for channel in 0..channels {
                let mut product = R::of(1.0);
                for (plane, [a, b]) in level.iter().zip(PAIRS) {
                    product = product * sample(plane, [q[a], q[b]], channel);
                }
                features.push(product);
            }
        }
    }
    features
}
