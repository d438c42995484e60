//! Twin of `nn/conv2d`, in `PyTorch`'s weight order `[Co, Ci, taps, taps]`; images are channels-last.

use crate::reference::real::Real;

/// Sizes of one convolution.
#[derive(Clone, Copy, Debug)]
pub struct Conv2d {
    /// Images.
    pub frames: usize,
    /// Of an input image.
    pub height: usize,
    /// Of an input image.
    pub width: usize,
    /// `Ci`
    pub in_channels: usize,
    /// `Co`
    pub out_channels: usize,
    /// Side of a filter.
    pub taps: usize,
    /// Zeros on every side.
    pub padding: usize,
}

impl Conv2d {
    /// Height and width of an output image.
    pub fn out_size(&self) -> (usize, usize) {
        (self.height + 2 * self.padding + 1 - self.taps, self.width + 2 * self.padding + 1 - self.taps)
    }

    /// Calls `pair(output pixel, input pixel, tap)` for every pixel that a window reads.
    fn each_pair(&self, mut pair: impl FnMut(usize, usize, usize)) {
        let (out_height, out_width) = self.out_size();
        for output in 0..self.frames * out_height * out_width {
            let (frame, y, x) =
                (output / (out_height * out_width), output / out_width % out_height, output % out_width);
            for tap in 0..self.taps * self.taps {
                let (row, column) = (y + tap / self.taps, x + tap % self.taps);
                let within = |at: usize, size: usize| at >= self.padding && at < size + self.padding;
                if within(row, self.height) && within(column, self.width) {
                    let (row, column) = (row - self.padding, column - self.padding);
                    pair(output, (frame * self.height + row) * self.width + column, tap);
                }
            }
        }
    }
}

/// `y[o] = bias[o] + Σ w[o, i, tap] x[i, tap]` per output pixel: `[F, H, W, Ci]` → `[F, H', W', Co]`.
pub fn forward<R: Real>(s: &Conv2d, x: &[R], weight: &[R], bias: &[R]) -> Vec<R> {
    let (out_height, out_width) = s.out_size();
    let mut y = bias.repeat(s.frames * out_height * out_width);
    let area = s.taps * s.taps;
    s.each_pair(|output, input, tap| {
        for o in 0..s.out_channels {
            for i in 0..s.in_channels {
                y[output * s.out_channels + o] +=
                    weight[(o * s.in_channels + i) * area + tap] * x[input * s.in_channels + i];
            }
        }
    });
    y
}

/// Adjoint of [`forward`] without its bias: `[F, H', W', Co]` → `[F, H, W, Ci]`.
pub fn backward<R: Real>(s: &Conv2d, weight: &[R], v_y: &[R]) -> Vec<R> {
    let mut v_x = vec![R::of(0.0); s.frames * s.height * s.width * s.in_channels];
    let area = s.taps * s.taps;
    s.each_pair(|output, input, tap| {
        for o in 0..s.out_channels {
            for i in 0..s.in_channels {
                v_x[input * s.in_channels + i] +=
                    weight[(o * s.in_channels + i) * area + tap] * v_y[output * s.out_channels + o];
            }
        }
    });
    v_x
}
