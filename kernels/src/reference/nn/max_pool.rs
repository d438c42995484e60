//! Twin of `nn/max_pool`.

use crate::nn::max_pool::MaxPool;
use crate::reference::real::Real;

/// For every output element the input element that it takes: the first of the largest, or the last NaN.
fn sources<R: Real>(s: &MaxPool, x: &[R]) -> Vec<usize> {
    let (out_height, out_width) = s.out_size();
    let mut sources = Vec::with_capacity(s.lens().1);
    for output in 0..s.frames * out_height * out_width {
        let (frame, row, column) =
            (output / (out_height * out_width), output / out_width % out_height, output % out_width);
        for channel in 0..s.channels {
            let at = |tap: usize| {
                let (y, x) = (row * s.stride + tap / s.side, column * s.stride + tap % s.side);
                ((frame * s.height + y) * s.width + x) * s.channels + channel
            };
            let mut best = at(0);
            for tap in 1..s.side * s.side {
                if x[at(tap)] > x[best] || x[at(tap)].f64().is_nan() {
                    best = at(tap);
                }
            }
            sources.push(best);
        }
    }
    sources
}

/// `[F, H, W, C]` → `[F, H', W', C]`.
pub fn forward<R: Real>(s: &MaxPool, x: &[R]) -> Vec<R> {
    sources(s, x).into_iter().map(|from| x[from]).collect()
}

/// Gradient to the input, `[F, H', W', C]` → `[F, H, W, C]`.
pub fn backward<R: Real>(s: &MaxPool, x: &[R], v_y: &[R]) -> Vec<R> {
    let mut v_x = vec![R::of(0.0); s.lens().0];
    for (from, v) in sources(s, x).into_iter().zip(v_y) {
        v_x[from] += *v;
    }
    v_x
}
