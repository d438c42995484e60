//! Image fidelity: PSNR, foreground PSNR and SSIM, always between marked and unmarked render.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::error::EngineError;
use crate::media::Frame;

/// Weights of the 11-tap Gaussian window, σ = 1.5, of Wang et al. 2004.
const SSIM_TAPS: usize = 11;
const SSIM_SIGMA: f64 = 1.5;
const SSIM_C1: f64 = 0.01 * 0.01;
const SSIM_C2: f64 = 0.03 * 0.03;

/// Colour samples of one picture; a fourth channel, if any, is never read.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    width: u32,
    height: u32,
    samples: Samples<'a>,
}

#[derive(Clone, Copy, Debug)]
enum Samples<'a> {
    Rgb8(&'a [u8]),
    Rgba32f(&'a [f32]),
}

impl<'a> Picture<'a> {
    /// An 8-bit frame; 255 counts as 1.
    #[must_use]
    pub fn from_frame(frame: &'a Frame) -> Self {
        Self { width: frame.width(), height: frame.height(), samples: Samples::Rgb8(frame.rgb()) }
    }

    /// A rendered picture `[H, W, 4]` with colours in \[0, 1\].
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the length is not 4·H·W.
    pub fn from_rgba32f(width: u32, height: u32, pixels: &'a [f32]) -> Result<Self, EngineError> {
        if pixels.len() as u64 != 4 * u64::from(width) * u64::from(height) {
            return Err(EngineError::Usage {
                what: "rendered picture".to_owned(),
                got: format!("{} numbers", pixels.len()),
                expected: format!("{height} x {width} x 4"),
            });
        }
        Ok(Self { width, height, samples: Samples::Rgba32f(pixels) })
    }

    fn num_pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    fn sample(&self, pixel: usize, channel: usize) -> f64 {
        match self.samples {
            Samples::Rgb8(rgb) => f64::from(rgb[3 * pixel + channel]) / 255.0,
            Samples::Rgba32f(rgba) => f64::from(rgba[4 * pixel + channel]),
        }
    }

    fn check_same_size(&self, other: &Self) -> Result<(), EngineError> {
        if (self.width, self.height) == (other.width, other.height) && self.num_pixels() > 0 {
            return Ok(());
        }
        Err(EngineError::Usage {
            what: "pictures to compare".to_owned(),
            got: format!("{} x {} px", other.width, other.height),
            expected: format!("{} x {} px, not empty", self.width, self.height),
        })
    }
}

/// A ratio in decibels. Identical pictures give infinity, which JSON lacks: it is written as `"inf"`.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Decibels(pub f64);

impl Serialize for Decibels {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0 == f64::INFINITY {
            serializer.serialize_str("inf")
        } else if self.0.is_finite() {
            serializer.serialize_f64(self.0)
        } else {
            Err(serde::ser::Error::custom(format!("{} dB is no result", self.0)))
        }
    }
}

impl<'de> Deserialize<'de> for Decibels {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Form {
            Number(f64),
            Word(String),
        }
        match Form::deserialize(deserializer)? {
            Form::Number(db) => Ok(Self(db)),
            Form::Word(word) if word == "inf" => Ok(Self(f64::INFINITY)),
            Form::Word(word) => Err(de::Error::custom(format!("`{word}`: a number or \"inf\""))),
        }
    }
}

/// Squared error of one picture or of a masked part of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SquaredError {
    /// Sum of squared differences in units of full scale.
    pub sum: f64,
    /// Number of samples (three per pixel).
    pub num_samples: u64,
}

impl SquaredError {
    /// Compares whole pictures.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the sizes differ or are empty.
    pub fn between(a: &Picture<'_>, b: &Picture<'_>) -> Result<Self, EngineError> {
        Self::over(a, b, |_| true)
    }

    /// Compares the pixels where `mask` `[H, W]` is true; see [`foreground`].
    ///
    /// # Errors
    /// [`EngineError::Usage`] if sizes differ or are empty.
    pub fn within(a: &Picture<'_>, b: &Picture<'_>, mask: &[bool]) -> Result<Self, EngineError> {
        if mask.len() != a.num_pixels() {
            return Err(EngineError::Usage {
                what: "foreground mask".to_owned(),
                got: format!("{} pixels", mask.len()),
                expected: format!("{} x {}", a.height, a.width),
            });
        }
        Self::over(a, b, |pixel| mask[pixel])
    }

    fn over(a: &Picture<'_>, b: &Picture<'_>, counts: impl Fn(usize) -> bool) -> Result<Self, EngineError> {
        a.check_same_size(b)?;
        let mut error = Self::default();
        for pixel in (0..a.num_pixels()).filter(|&pixel| counts(pixel)) {
            for channel in 0..3 {
                let difference = a.sample(pixel, channel) - b.sample(pixel, channel);
                error.sum += difference * difference;
            }
            error.num_samples += 3;
        }
        Ok(error)
    }

    /// Mean squared error; NaN if nothing was compared.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.sum / self.num_samples as f64
    }

    /// Peak signal-to-noise ratio, −10 log₁₀ MSE. Infinite for identical pictures, NaN for nothing or NaN.
    #[must_use]
    pub fn psnr(&self) -> Decibels {
        Decibels(-10.0 * self.mean().log10())
    }
}

/// Pixels that splats cover: 1 − T above `threshold`, for final transmittances `T`. NaN is background.
#[must_use]
pub fn foreground(transmittance: impl IntoIterator<Item = f32>, threshold: f32) -> Vec<bool> {
    let covered = |t: f32| 1.0 - t > threshold;
    transmittance.into_iter().map(covered).collect()
}

/// PSNR over several views, averaged both ways since published figures use either.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PsnrSummary {
    /// Mean of the views' PSNR; infinite as soon as one view is identical.
    pub mean_of_views_db: Decibels,
    /// PSNR of the error pooled over all views; at most the mean.
    pub pooled_db: Decibels,
    /// Worst view.
    pub min_db: Decibels,
    /// Views compared.
    pub num_views: u32,
    /// Views without any difference.
    pub num_identical: u32,
}

impl PsnrSummary {
    /// Summarises per-view errors; views without samples (an empty foreground) are left out.
    /// `None` if nothing was compared.
    #[must_use]
    pub fn of(errors: &[SquaredError]) -> Option<Self> {
        let views: Vec<_> = errors.iter().filter(|e| e.num_samples > 0).collect();
        if views.is_empty() {
            return None;
        }
        let pooled = views.iter().fold(SquaredError::default(), |all, view| SquaredError {
            sum: all.sum + view.sum,
            num_samples: all.num_samples + view.num_samples,
        });
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let sum_db: f64 = views.iter().map(|view| view.psnr().0).sum();
        let worst = views.iter().map(|view| view.mean()).fold(0.0, worse);
        Some(Self {
            mean_of_views_db: Decibels(sum_db / views.len() as f64),
            pooled_db: pooled.psnr(),
            min_db: Decibels(-10.0 * worst.log10()),
            num_views: count(views.len()),
            num_identical: count(views.iter().filter(|view| view.sum == 0.0).count()),
        })
    }
}

/// Larger of two errors, where NaN is larger than anything.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || a >= b { a } else { b }
}

/// Structural similarity, mean over pixels and colours; 1 for identical pictures, NaN if any sample is.
///
/// # Equation
/// Wang et al. 2004, eq. 13, data range 1: 11 × 11 Gaussian window with σ = 1.5, zero padding.
/// # Errors
/// [`EngineError::Usage`] if sizes differ or are empty.
pub fn ssim(a: &Picture<'_>, b: &Picture<'_>) -> Result<f64, EngineError> {
    a.check_same_size(b)?;
    let window = gaussian_window();
    let num_pixels = a.num_pixels();
    let blur = |plane: &dyn Fn(usize) -> f64| {
        let plane: Vec<f64> = (0..num_pixels).map(plane).collect();
        blur_zero_padded(&plane, a.width as usize, &window)
    };
    let mut sum = 0.0;
    for channel in 0..3 {
        let (x, y) = (|p| a.sample(p, channel), |p| b.sample(p, channel));
        let (mean_x, mean_y) = (blur(&x), blur(&y));
        let (mean_xx, mean_yy) = (blur(&|p| x(p) * x(p)), blur(&|p| y(p) * y(p)));
        let mean_xy = blur(&|p| x(p) * y(p));
        for p in 0..num_pixels {
            let (mx, my) = (mean_x[p], mean_y[p]);
            let (var_x, var_y) = (mean_xx[p] - mx * mx, mean_yy[p] - my * my);
            let covariance = mean_xy[p] - mx * my;
            sum += (2.0 * mx * my + SSIM_C1) * (2.0 * covariance + SSIM_C2)
                / ((mx * mx + my * my + SSIM_C1) * (var_x + var_y + SSIM_C2));
        }
    }
    Ok(sum / (3 * num_pixels) as f64)
}

fn gaussian_window() -> [f64; SSIM_TAPS] {
    let centre = (SSIM_TAPS / 2) as f64;
    let weight = |tap: usize| {
        let offset = tap as f64 - centre;
        (-offset * offset / (2.0 * SSIM_SIGMA * SSIM_SIGMA)).exp()
    };
    let weights: [f64; SSIM_TAPS] = std::array::from_fn(weight);
    let total: f64 = weights.iter().sum();
    weights.map(|w| w / total)
}

fn blur_zero_padded(plane: &[f64], width: usize, window: &[f64; SSIM_TAPS]) -> Vec<f64> {
    let height = plane.len() / width;
    let across = convolve(plane, window, |pixel| (pixel % width, width, 1));
    convolve(&across, window, |pixel| (pixel / width, height, width))
}

/// `axis(pixel)` = position on the axis, length of the axis, distance between neighbours.
fn convolve(plane: &[f64], window: &[f64; SSIM_TAPS], axis: impl Fn(usize) -> (usize, usize, usize)) -> Vec<f64> {
    let half = SSIM_TAPS / 2;
    let at = |pixel: usize| {
        let (position, length, stride) = axis(pixel);
        let first = half.saturating_sub(position);
        let last = SSIM_TAPS.min(length + half - position);
        (first..last).map(|tap| window[tap] * plane[pixel + tap * stride - half * stride]).sum()
    };
    (0..plane.len()).map(at).collect()
}
