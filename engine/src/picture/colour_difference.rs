//! How different two colours look, as the CIE defines it: CIEDE2000.
//!
//! PSNR counts all colours alike. The eye does not: a step of the same size is seen two to four times as easily on grey
//! and black as on saturated orange or blue.

use palette::color_difference::Ciede2000;
use palette::{IntoColor, Lab, Srgb};
use serde::Serialize;

use crate::error::EngineError;
use crate::media::Frame;
use crate::scene::gaussians::CHANNELS;

/// Share of the pixels that [`ColourDifference::p95`] leaves above itself.
const RARE: f64 = 0.05;

/// CIEDE2000 difference of two sRGB colours with values in \[0, 1\] (beyond, they are clamped). Around 1 is the least
/// that is seen side by side, 2 to 3 what is seen at a glance.
#[must_use]
pub fn difference(a: [f32; CHANNELS], b: [f32; CHANNELS]) -> f32 {
    lab(a).difference(lab(b))
}

/// CIEDE2000 between marked and unmarked 8-bit frames over the pixels of the object, those of all frames together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ColourDifference {
    /// Mean.
    pub mean: f64,
    /// Value that one pixel in twenty exceeds.
    pub p95: f64,
}

impl ColourDifference {
    /// Of single pixels' differences; `None` without a pixel.
    #[must_use]
    pub fn of(mut pixels: Vec<f32>) -> Option<Self> {
        if pixels.is_empty() {
            return None;
        }
        // NaN sorts last, so that it is not lost: it shows in the mean.
        pixels.sort_by(f32::total_cmp);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
        let rank = ((1.0 - RARE) * (pixels.len() - 1) as f64).round() as usize;
        let sum: f64 = pixels.iter().copied().map(f64::from).sum();
        Some(Self { mean: sum / pixels.len() as f64, p95: f64::from(pixels[rank]) })
    }
}

/// Differences of the pixels where `mask` `[H, W]` is true.
///
/// # Errors
/// [`EngineError::Usage`] if sizes differ.
pub fn pixels_within(a: &Frame, b: &Frame, mask: &[bool]) -> Result<Vec<f32>, EngineError> {
    let pixels = |frame: &Frame| frame.rgb().len() / CHANNELS;
    if pixels(a) != pixels(b) || mask.len() != pixels(a) {
        return Err(EngineError::Usage {
            what: "frames to compare".to_owned(),
            got: format!("{} and {} pixels, a mask of {}", pixels(a), pixels(b), mask.len()),
            expected: "as many of each".to_owned(),
        });
    }
    let colours = a.rgb().as_chunks::<CHANNELS>().0.iter().zip(b.rgb().as_chunks::<CHANNELS>().0);
    let unit = |rgb: &[u8; CHANNELS]| rgb.map(|v| f32::from(v) / 255.0);
    let inside = colours.zip(mask).filter(|(_, inside)| **inside);
    Ok(inside.map(|((a, b), _)| if a == b { 0.0 } else { difference(unit(a), unit(b)) }).collect())
}

fn lab([red, green, blue]: [f32; CHANNELS]) -> Lab {
    Srgb::new(red.clamp(0.0, 1.0), green.clamp(0.0, 1.0), blue.clamp(0.0, 1.0)).into_color()
}
