//! Pictures in one channel, as they are compared.

use crate::media::Frame;
use crate::media::frames::LUMA;

/// Range of values that codecs make of one colour.
const PLAIN: f32 = 4.0 / 255.0;

/// A picture of one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Gray {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Values, row by row.
    pub values: Vec<f32>,
}

impl Gray {
    /// Luma of a frame, 0 to 1.
    #[must_use]
    pub fn of_frame(frame: &Frame) -> Self {
        let luma = |rgb: &[u8]| LUMA.iter().zip(rgb).map(|(w, level)| w * f32::from(*level) / 255.0).sum();
        let (width, height) = (frame.width() as usize, frame.height() as usize);
        Self { width, height, values: frame.rgb().chunks_exact(3).map(luma).collect() }
    }

    /// Luma of rendered pixels `[H, W, 4]`, as films show them: within 0 and 1.
    #[must_use]
    pub fn of_pixels(width: usize, height: usize, pixels: &[f32]) -> Self {
        let luma = |rgba: &[f32]| LUMA.iter().zip(rgba).map(|(w, value)| w * value.clamp(0.0, 1.0)).sum();
        Self { width, height, values: pixels.chunks_exact(4).map(luma).collect() }
    }

    /// Whether it shows one colour, which says of no asset where it was seen from.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        let least = self.values.iter().copied().fold(f32::INFINITY, f32::min);
        self.values.iter().all(|value| value - least <= PLAIN)
    }

    /// Left and right exchanged.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let values = self.values.chunks_exact(self.width).flat_map(|row| row.iter().rev()).copied().collect();
        Self { values, ..*self }
    }

    /// The picture with sides of at most so many pixels.
    #[must_use]
    pub fn within(self, longest_px: u32) -> Self {
        let scale = f64::from(longest_px) / self.width.max(self.height) as f64;
        if scale >= 1.0 {
            return self;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a side, at most `longest_px`")]
        let [width, height] = [self.width, self.height].map(|side| (side as f64 * scale).round().max(1.0) as usize);
        self.resized(width, height)
    }

    /// The picture at another size, each pixel the mean of what it covers.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        if (width, height) == (self.width, self.height) {
            return self.clone();
        }
        let across = shares(self.width, width);
        let down = shares(self.height, height);
        let mut rows = vec![0.0; width * self.height];
        for (out, row) in rows.chunks_exact_mut(width).zip(self.values.chunks_exact(self.width)) {
            for (value, covered) in out.iter_mut().zip(&across) {
                *value = covered.iter().map(|(at, share)| row[*at] * share).sum();
            }
        }
        let mut values = vec![0.0; width * height];
        for (out, covered) in values.chunks_exact_mut(width).zip(&down) {
            for (at, share) in covered {
                out.iter_mut().zip(&rows[at * width..]).for_each(|(value, row)| *value += share * row);
            }
        }
        Self { width, height, values }
    }

    /// The least value within so many pixels of each, right, left, up and down.
    #[must_use]
    pub fn least_within(&self, px: usize) -> Self {
        let Self { width, height, values } = self;
        let least = |values: &[f32], at: usize, step: usize, count: usize| {
            let (from, place) = (at - at / step % count * step, at / step % count);
            let near = place.saturating_sub(px)..=(place + px).min(count - 1);
            near.map(|place| values[from + place * step]).fold(f32::INFINITY, f32::min)
        };
        let across: Vec<f32> = (0..values.len()).map(|at| least(values, at, 1, *width)).collect();
        let values = (0..values.len()).map(|at| least(&across, at, *width, *height)).collect();
        Self { values, ..*self }
    }

    /// How fast values change, right and down, `[H, W]` each, in units of a pixel: half the difference of both
    /// neighbours; 0 at the ends.
    #[must_use]
    pub fn slope(&self) -> [Vec<f32>; 2] {
        self.differences(1).map(|of| of.into_iter().map(|difference| 0.5 * difference).collect())
    }

    /// Differences of neighbours, right and down, `[H, W]` each; 0 at the ends.
    #[must_use]
    pub fn gradient(&self) -> [Vec<f32>; 2] {
        self.differences(0)
    }

    /// The next value less the one `back` before, right and down; 0 where one of them is not there.
    fn differences(&self, back: usize) -> [Vec<f32>; 2] {
        let Self { width, height, values } = self;
        let mut differences = [vec![0.0; values.len()], vec![0.0; values.len()]];
        for y in 0..*height {
            for x in 0..*width {
                let at = y * width + x;
                if x >= back && x + 1 < *width {
                    differences[0][at] = values[at + 1] - values[at - back];
                }
                if y >= back && y + 1 < *height {
                    differences[1][at] = values[at + width] - values[at - back * width];
                }
            }
        }
        differences
    }
}

/// For each of `to` pixels, which of `from` it covers, and by what share of its own.
fn shares(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            let (start, end) = (i as f64 * scale, (i + 1) as f64 * scale);
            let covered = (0..from).skip_while(|at| ((at + 1) as f64) <= start).take_while(|at| (*at as f64) < end);
            covered
                .map(|at| {
                    let part = ((at + 1) as f64).min(end) - (at as f64).max(start);
                    (at, crate::base::numbers::narrow(part / scale))
                })
                .collect()
        })
        .collect()
}

/// How alike the gradients of two pictures of one size are, −1 to 1; 0 where one of them has none.
#[must_use]
pub fn correlation(a: &Gray, b: &Gray) -> f64 {
    correlation_where(a, b, |_| true)
}

/// The same of the pixels that count alone, by their index.
#[must_use]
pub fn correlation_where(a: &Gray, b: &Gray, counts: impl Fn(usize) -> bool) -> f64 {
    let (a, b) = (a.gradient(), b.gradient());
    let dot = |p: &[Vec<f32>; 2], q: &[Vec<f32>; 2]| -> f64 {
        let products = p.iter().zip(q).flat_map(|(p, q)| p.iter().zip(q).enumerate());
        products.filter(|(at, _)| counts(*at)).map(|(_, (p, q))| f64::from(p * q)).sum()
    };
    let sizes = (dot(&a, &a) * dot(&b, &b)).sqrt();
    if sizes > 0.0 { dot(&a, &b) / sizes } else { 0.0 }
}
