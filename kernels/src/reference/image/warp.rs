//! Twin of `image/warp`, as a sum over what every output pixel reads.

use crate::reference::real::Real;

/// Where output pixels read, as in the host's `Warp`, with 1 for bilinear reads and 0 for the nearest pixel.
#[derive(Clone, Copy, Debug)]
pub struct Reads {
    /// Rows `[x from column, x from row, x]` and the same for y.
    pub map: [[f64; 3]; 2],
    /// Whether it reads linearly between four pixels.
    pub bilinear: bool,
}

impl Reads {
    /// Calls `visit(input pixel or None outside, weight)` for what the output pixel at `(row, column)` reads.
    fn visit(&self, [height, width]: [usize; 2], row: usize, column: usize, mut visit: impl FnMut(Option<usize>, f64)) {
        let source = self.map.map(|m| m[0] * column as f64 + m[1] * row as f64 + m[2]);
        let first = source.map(|s| if self.bilinear { s.floor() } else { (s + 0.5).floor() });
        for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let share = |axis: usize, d: usize| {
                let part = source[axis] - first[axis];
                if !self.bilinear {
                    return if d == 0 { 1.0 } else { 0.0 };
                }
                if d == 0 { 1.0 - part } else { part }
            };
            let weight = share(0, dx) * share(1, dy);
            let (x, y) = (first[0] + dx as f64, first[1] + dy as f64);
            let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
            if weight > 0.0 {
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the frame")]
                visit(inside.then_some((y as usize) * width + x as usize), weight);
            }
        }
    }
}

/// One frame `[H,W,4]` warped, `fill` outside, fourth channel 0.
pub fn forward<R: Real>(x: &[R], size: [usize; 2], reads: &Reads, fill: [R; 3]) -> Vec<R> {
    let mut y = vec![R::of(0.0); x.len()];
    for i in 0..size[0] * size[1] {
        reads.visit(size, i / size[1], i % size[1], |from, weight| {
            for c in 0..3 {
                y[i * 4 + c] += R::of(weight) * from.map_or(fill[c], |from| x[from * 4 + c]);
            }
        });
    }
    y
}

/// Gradient to x, fourth channel 0.
pub fn backward<R: Real>(v_y: &[R], size: [usize; 2], reads: &Reads) -> Vec<R> {
    let mut v_x = vec![R::of(0.0); v_y.len()];
    for i in 0..size[0] * size[1] {
        reads.visit(size, i / size[1], i % size[1], |from, weight| {
            for c in 0..3 {
                if let Some(from) = from {
                    v_x[from * 4 + c] += R::of(weight) * v_y[i * 4 + c];
                }
            }
        });
    }
    v_x
}
