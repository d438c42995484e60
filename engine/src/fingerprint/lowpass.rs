//! What a codec left of the detail of a picture, told from film and clean picture alone.
//!
//! Codecs drop detail that is fine or faint. What they dropped of the asset stands in the difference to the clean
//! picture, many times larger than a mark, and alike wherever the asset is alike. So each part of the clean picture's
//! detail is first brought to what the film kept of it.

use std::f32::consts::PI;

use rayon::prelude::*;

use crate::base::numbers::narrow;

/// Side of a block in pixels, as most codecs have it.
const SIDE: usize = 8;
const BLOCK: usize = SIDE * SIDE;
/// Steps of fineness: the sum of both frequencies, the last with all that are finer.
const FINENESS: usize = 8;
/// Steps of strength, each twice the one before, from a quarter of a level of 8 bits on.
const STRENGTHS: usize = 14;
const WEAKEST: f32 = 0.25;
/// Coefficients from which on a group says what was kept of it.
const ENOUGH: u32 = 32;

/// What the first coefficient is of a block of which half is 1, and half 0.
const HALF: f32 = 0.5 * SIDE as f32;

/// A picture's blocks, each as the coefficients of its cosine transform.
struct Blocks {
    coefficients: Vec<[f32; BLOCK]>,
    width: usize,
    height: usize,
}

/// What is known of the coefficients of one fineness and strength.
#[derive(Clone, Copy, Default)]
struct Kept {
    both: f64,
    clean: f64,
    count: u32,
}

/// A film's picture and what it was before, and which of its pixels count; rows of `width` pixels each.
pub(super) struct Pictures<'a> {
    pub film: &'a [f32],
    pub clean: &'a [f32],
    pub counted: &'a [bool],
    pub width: usize,
}

/// The clean picture as a codec left it that made the film's of it.
///
/// # Equation
/// Each 8x8 coefficient of the clean picture times Σ film·clean / Σ clean² over all of about its frequency and size, in
/// blocks of which at least half counts.
pub(super) fn as_kept(pictures: &Pictures<'_>) -> Vec<f32> {
    let Pictures { film, clean, counted, width } = *pictures;
    let film = Blocks::of(film, width);
    let counts: Vec<f32> = counted.iter().map(|counted| f32::from(u8::from(*counted))).collect();
    let counts = Blocks::of(&counts, width);
    let mut clean = Blocks::of(clean, width);
    let mut kept = [Kept::default(); FINENESS * STRENGTHS];
    let blocks = film.coefficients.iter().zip(&clean.coefficients).zip(&counts.coefficients);
    // A block's first coefficient is its mean, times its side.
    for ((film, clean), _) in blocks.filter(|(_, counts)| counts[0] >= HALF) {
        for (at, (film, clean)) in film.iter().zip(clean).enumerate() {
            kept[group(at, *clean)].add(*film, *clean);
        }
    }
    for block in &mut clean.coefficients {
        for (at, clean) in block.iter_mut().enumerate() {
            *clean *= kept[group(at, *clean)].share();
        }
    }
    clean.picture()
}

impl Kept {
    fn add(&mut self, film: f32, clean: f32) {
        let (film, clean) = (f64::from(film), f64::from(clean));
        self.both += film * clean;
        self.clean += clean * clean;
        self.count += 1;
    }

    fn share(&self) -> f32 {
        if self.count < ENOUGH || self.clean <= 0.0 { 1.0 } else { narrow(self.both / self.clean) }
    }
}

/// The group of the coefficient at this place of a block.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "kept among the steps")]
fn group(at: usize, coefficient: f32) -> usize {
    let fineness = (at / SIDE + at % SIDE).min(FINENESS - 1);
    let strength = (coefficient.abs() * 255.0 / WEAKEST).max(1.0).log2().min((STRENGTHS - 1) as f32) as usize;
    fineness * STRENGTHS + strength
}

/// The rows of the orthonormal cosine transform (DCT-II).
fn cosines() -> [[f32; SIDE]; SIDE] {
    std::array::from_fn(|frequency| {
        let scale = if frequency == 0 { (1.0 / SIDE as f32).sqrt() } else { (2.0 / SIDE as f32).sqrt() };
        std::array::from_fn(|x| scale * (PI * (2 * x + 1) as f32 * frequency as f32 / (2 * SIDE) as f32).cos())
    })
}

/// `rows · block · rowsᵀ`, or with the transposes, back.
fn transformed(block: &[f32; BLOCK], rows: &[[f32; SIDE]; SIDE], is_back: bool) -> [f32; BLOCK] {
    let factor = |i: usize, k: usize| if is_back { rows[k][i] } else { rows[i][k] };
    let half: [f32; BLOCK] =
        std::array::from_fn(|at| (0..SIDE).map(|k| factor(at / SIDE, k) * block[k * SIDE + at % SIDE]).sum());
    std::array::from_fn(|at| (0..SIDE).map(|k| factor(at % SIDE, k) * half[at / SIDE * SIDE + k]).sum())
}

impl Blocks {
    /// Blocks that reach beyond the picture go on with its last row and column.
    fn of(picture: &[f32], width: usize) -> Self {
        let (rows, height) = (cosines(), picture.len() / width);
        let across = width.div_ceil(SIDE);
        let block = |i: usize| {
            let (left, top) = (i % across * SIDE, i / across * SIDE);
            let pixel = |at: usize| {
                let (x, y) = ((left + at % SIDE).min(width - 1), (top + at / SIDE).min(height - 1));
                picture[y * width + x]
            };
            transformed(&std::array::from_fn(pixel), &rows, false)
        };
        Self { coefficients: (0..across * height.div_ceil(SIDE)).into_par_iter().map(block).collect(), width, height }
    }

    fn picture(&self) -> Vec<f32> {
        let (rows, across) = (cosines(), self.width.div_ceil(SIDE));
        let blocks: Vec<_> = self.coefficients.par_iter().map(|block| transformed(block, &rows, true)).collect();
        let pixel = |at: usize| {
            let (x, y) = (at % self.width, at / self.width);
            blocks[y / SIDE * across + x / SIDE][y % SIDE * SIDE + x % SIDE]
        };
        (0..self.width * self.height).map(pixel).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No multiple of a block's side.
    const WIDTH: usize = 61;
    const HEIGHT: usize = 45;

    fn picture(pixel: impl Fn(usize, usize) -> f32) -> Vec<f32> {
        (0..WIDTH * HEIGHT).map(|at| pixel(at % WIDTH, at / WIDTH)).collect()
    }

    fn kept(film: &[f32], clean: &[f32], counted: &[bool]) -> Vec<f32> {
        as_kept(&Pictures { film, clean, counted, width: WIDTH })
    }

    fn largest(a: &[f32], b: &[f32]) -> f32 {
        let largest = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(a.iter().chain(b).all(|value| value.is_finite()));
        largest
    }

    /// Coarse shapes, and stripes of two pixels.
    fn shapes(stripes: f32) -> Vec<f32> {
        picture(|x, y| {
            let fine = if (x + y) % 2 == 0 { stripes } else { -stripes };
            0.5 + 0.2 * (x as f32 / 9.0).sin() * (y as f32 / 7.0).cos() + fine
        })
    }

    #[test]
    fn a_film_that_kept_all_is_compared_with_the_clean_picture() {
        let clean = shapes(0.1);
        // Rounding of 32-bit floats, in sums of 64.
        assert!(largest(&kept(&clean, &clean, &vec![true; clean.len()]), &clean) < 1e-5);
    }

    #[test]
    fn detail_that_a_codec_dropped_is_dropped_and_a_mark_is_left() {
        let (clean, film) = (shapes(0.1), shapes(0.02));
        let all = vec![true; clean.len()];
        let whole =
            (0..WIDTH * HEIGHT).filter(|at| at % WIDTH < WIDTH / SIDE * SIDE && at / WIDTH < HEIGHT / SIDE * SIDE);
        let whole: Vec<usize> = whole.collect();
        let rest = |film: &[f32], kept: &[f32]| -> Vec<f32> { whole.iter().map(|at| film[*at] - kept[*at]).collect() };
        let left = rest(&film, &kept(&film, &clean, &all));
        // Of 0.08; what is coarse is in the same groups as a little of the stripes.
        assert!(left.iter().all(|left| left.abs() < 0.02), "{:?}", left.iter().fold(0.0f32, |a, b| a.max(b.abs())));
        // Signs of a mark that the clean picture knows nothing of, whole numbers' hash.
        let sign = |at: usize| if at.wrapping_mul(2_654_435_761) >> 31 & 1 == 0 { 0.004 } else { -0.004 };
        let marked: Vec<f32> = film.iter().enumerate().map(|(at, level)| level + sign(at)).collect();
        let with_mark = rest(&marked, &kept(&marked, &clean, &all));
        let share: f32 = whole
            .iter()
            .zip(with_mark.iter().zip(&left))
            .map(|(at, (with, without))| (with - without) * sign(*at))
            .sum::<f32>()
            / whole.iter().map(|at| sign(*at).powi(2)).sum::<f32>();
        // 112 gains are fitted to 1960 pixels, and take that part of a mark at most.
        assert!((0.9..1.01).contains(&share), "{share}");
    }

    #[test]
    fn blocks_that_hardly_count_say_nothing_of_others() {
        let clean = shapes(0.1);
        let counted: Vec<bool> = (0..clean.len()).map(|at| at % WIDTH < 32).collect();
        let film: Vec<f32> =
            clean.iter().zip(&counted).map(|(clean, counted)| if *counted { *clean } else { 0.3 * clean }).collect();
        let kept = kept(&film, &clean, &counted);
        let off = |at: &usize| (kept[*at] - clean[*at]).abs();
        // As where all is kept: the dark half is not asked.
        assert!((0..clean.len()).filter(|at| counted[*at]).all(|at| off(&at) < 1e-5));
    }
}
