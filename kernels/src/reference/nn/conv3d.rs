//! Twin of `nn/conv3d_*`, in PyTorch's weight order `[Co, Ci, 3, 3, 3]`.

use crate::reference::real::Real;

/// What lies outside an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Padding {
    /// Zeros.
    Zero,
    /// The nearest entry.
    Replicate,
    /// The mirror image without the border entry.
    Reflect,
}

/// Sizes and padding of one layer.
#[derive(Clone, Copy, Debug)]
pub struct Conv3d {
    /// `F, H, W`
    pub shape: [usize; 3],
    /// `Ci`
    pub in_channels: usize,
    /// `Co`
    pub out_channels: usize,
    /// Padding along frames.
    pub time: Padding,
    /// Padding along rows and columns.
    pub space: Padding,
}

/// Entry that position `c + d - 1` of an axis with `n` entries reads.
fn source(c: usize, d: usize, n: usize, padding: Padding) -> Option<usize> {
    match (c + d, padding) {
        (0, Padding::Zero) => None,
        (0, Padding::Replicate) => Some(0),
        (0, Padding::Reflect) => Some(1),
        (after, _) if after <= n => Some(after - 1),
        (_, Padding::Zero) => None,
        (_, Padding::Replicate) => Some(n - 1),
        (_, Padding::Reflect) => Some(n - 2),
    }
}

impl Conv3d {
    /// Calls `visit(output pixel, tap, input pixel)` for every product of the sum.
    fn each(&self, mut visit: impl FnMut(usize, usize, usize)) {
        let [frames, height, width] = self.shape;
        for out in 0..frames * height * width {
            let (t, y, x) = (out / (height * width), out / width % height, out % width);
            for tap in 0..27 {
                let st = source(t, tap / 9, frames, self.time);
                let sy = source(y, tap / 3 % 3, height, self.space);
                let sx = source(x, tap % 3, width, self.space);
                if let (Some(st), Some(sy), Some(sx)) = (st, sy, sx) {
                    visit(out, tap, (st * height + sy) * width + sx);
                }
            }
        }
    }

    fn weight_at(&self, co: usize, ci: usize, tap: usize) -> usize {
        (co * self.in_channels + ci) * 27 + tap
    }

    /// `y [F,H,W,Co]` from `x [F,H,W,Ci]`.
    pub fn forward<R: Real>(&self, x: &[R], weight: &[R], bias: &[R]) -> Vec<R> {
        let (ni, no) = (self.in_channels, self.out_channels);
        let mut y: Vec<R> = (0..self.shape.iter().product::<usize>()).flat_map(|_| bias.iter().copied()).collect();
        self.each(|out, tap, from| {
            for co in 0..no {
                for ci in 0..ni {
                    y[out * no + co] += weight[self.weight_at(co, ci, tap)] * x[from * ni + ci];
                }
            }
        });
        y
    }

    /// `v_x [F,H,W,Ci]`
    pub fn backward_input<R: Real>(&self, v_y: &[R], weight: &[R]) -> Vec<R> {
        let (ni, no) = (self.in_channels, self.out_channels);
        let mut v_x = vec![R::of(0.0); self.shape.iter().product::<usize>() * ni];
        self.each(|out, tap, from| {
            for co in 0..no {
                for ci in 0..ni {
                    v_x[from * ni + ci] += weight[self.weight_at(co, ci, tap)] * v_y[out * no + co];
                }
            }
        });
        v_x
    }

    /// `(v_weight [Co,Ci,3,3,3], v_bias [Co])`
    pub fn backward_weight<R: Real>(&self, x: &[R], v_y: &[R]) -> (Vec<R>, Vec<R>) {
        let (ni, no) = (self.in_channels, self.out_channels);
        let mut v_weight = vec![R::of(0.0); no * ni * 27];
        self.each(|out, tap, from| {
            for co in 0..no {
                for ci in 0..ni {
                    v_weight[self.weight_at(co, ci, tap)] += v_y[out * no + co] * x[from * ni + ci];
                }
            }
        });
        let mut v_bias = vec![R::of(0.0); no];
        for pixel in v_y.chunks_exact(no) {
            for (sum, v) in v_bias.iter_mut().zip(pixel) {
                *sum += *v;
            }
        }
        (v_weight, v_bias)
    }
}

/// max(0, y) of every element.
pub fn relu<R: Real>(y: &mut [R]) {
    for v in y {
        if *v < R::of(0.0) {
            *v = R::of(0.0);
        }
    }
}

/// Gradient before the ReLU that made `y`: zero where `y <= 0`, so a NaN lets it pass, as in `PyTorch`.
pub fn relu_backward<R: Real>(y: &[R], v_y: &mut [R]) {
    for (v, y) in v_y.iter_mut().zip(y) {
        *v = if *y <= R::of(0.0) { R::of(0.0) } else { *v };
    }
}
