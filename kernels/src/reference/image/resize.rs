//! Twin of `image/resize_apply`: the dense matrices, straight from `ATen`'s formula.

use crate::reference::real::Real;

/// `[to, from]` matrix of one axis: antialiased bilinear with `align_corners=True`.
pub fn matrix<R: Real>(from: usize, to: usize) -> Vec<R> {
    part_matrix(from, to, [0.0, from as f64])
}

/// The same of the part of the axis that begins at `first` and is `length` long. Outputs that look at nothing but the
/// outside see the outermost entry.
pub fn part_matrix<R: Real>(from: usize, to: usize, [first, length]: [f64; 2]) -> Vec<R> {
    let scale = if to > 1 { f64::max(length - 1.0, 0.0) / (to as f64 - 1.0) } else { 0.0 };
    let support = if scale > 1.0 { scale } else { 1.0 };
    let mut matrix = vec![R::of(0.0); to * from];
    for o in 0..to {
        let center = first + scale * (o as f64 + 0.5);
        let low = (center - support + 0.5).trunc().max(0.0);
        let high = (center + support + 0.5).trunc().min(from as f64);
        let inside = |i: usize| i as f64 >= low && (i as f64) < high;
        let weight = |i: usize| {
            let distance = ((i as f64 + 0.5 - center) / support).abs();
            if inside(i) && distance < 1.0 { 1.0 - distance } else { 0.0 }
        };
        let total: f64 = (0..from).map(weight).sum();
        if total == 0.0 {
            matrix[o * from + if center < 0.0 { 0 } else { from - 1 }] = R::of(1.0);
            continue;
        }
        for i in 0..from {
            matrix[o * from + i] = R::of(weight(i) / total);
        }
    }
    matrix
}

/// `[n, n]` matrix of a Gaussian cut off `radius` from its middle; the signal is mirrored about its first and last
/// entry.
pub fn blur_matrix<R: Real>(n: usize, sigma: f64, radius: usize) -> Vec<R> {
    let weight = |d: i64| (-(d as f64).powi(2) / (2.0 * sigma * sigma)).exp();
    #[allow(clippy::cast_possible_wrap, reason = "axes of test pictures")]
    let (length, radius) = (n as i64, radius as i64);
    let total: f64 = (-radius..=radius).map(weight).sum();
    let mut matrix = vec![R::of(0.0); n * n];
    for i in 0..n {
        for d in -radius..=radius {
            #[allow(clippy::cast_possible_wrap, reason = "axes of test pictures")]
            let mut source = i as i64 + d;
            while n > 1 && !(0..length).contains(&source) {
                source = if source < 0 { -source } else { 2 * (length - 1) - source };
            }
            let source = usize::try_from(source).unwrap_or(0).min(n - 1);
            matrix[i * n + source] += R::of(weight(d) / total);
        }
    }
    matrix
}

/// `y [F,h,w,4]` from `x [F,H,W,4]`; sizes are `[height, width]`.
pub fn forward<R: Real>(x: &[R], from: [usize; 2], to: [usize; 2]) -> Vec<R> {
    filter(x, from, to, &matrix::<R>(from[0], to[0]), &matrix::<R>(from[1], to[1]))
}

/// The same with any `[to, from]` matrix along each axis.
pub fn filter<R: Real>(x: &[R], from: [usize; 2], to: [usize; 2], vertical: &[R], horizontal: &[R]) -> Vec<R> {
    let frames = x.len() / (from[0] * from[1] * 4);
    let mut y = vec![R::of(0.0); frames * to[0] * to[1] * 4];
    each(frames, from, to, vertical, horizontal, |source, target, weight| {
        for c in 0..3 {
            y[target * 4 + c] += weight * x[source * 4 + c];
        }
    });
    y
}

/// `v_x [F,H,W,4]` from `v_y [F,h,w,4]`.
pub fn backward<R: Real>(v_y: &[R], from: [usize; 2], to: [usize; 2]) -> Vec<R> {
    let (vertical, horizontal) = (matrix::<R>(from[0], to[0]), matrix::<R>(from[1], to[1]));
    let frames = v_y.len() / (to[0] * to[1] * 4);
    let mut v_x = vec![R::of(0.0); frames * from[0] * from[1] * 4];
    each(frames, from, to, &vertical, &horizontal, |source, target, weight| {
        for c in 0..3 {
            v_x[source * 4 + c] += weight * v_y[target * 4 + c];
        }
    });
    v_x
}

/// Calls `visit(input pixel, output pixel, weight)` for every non-zero weight.
fn each<R: Real>(
    frames: usize,
    from: [usize; 2],
    to: [usize; 2],
    vertical: &[R],
    horizontal: &[R],
    mut visit: impl FnMut(usize, usize, R),
) {
    for target in 0..frames * to[0] * to[1] {
        let (f, oy, ox) = (target / (to[0] * to[1]), target / to[1] % to[0], target % to[1]);
        for iy in 0..from[0] {
            for ix in 0..from[1] {
                let weight = vertical[oy * from[0] + iy] * horizontal[ox * from[1] + ix];
                if weight != R::of(0.0) {
                    visit((f * from[0] + iy) * from[1] + ix, target, weight);
                }
            }
        }
    }
}
