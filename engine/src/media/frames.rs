//! 8-bit frames, and what is known of the clip that they are of.

use std::num::NonZeroU32;

use guard4d_kernels::image::chroma420::JFIF;

use crate::error::EngineError;

/// Largest frame side accepted; a corrupt header may claim anything.
pub(super) const MAX_SIDE_PX: u32 = 16_384;

/// Weights of red, green and blue in the luma of ITU-R BT.601, which codecs keep at full size.
pub const LUMA: [f32; 3] = JFIF[0];

/// An 8-bit RGB picture, rows from top to bottom.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

impl Frame {
    /// Wraps samples `[H, W, 3]`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the picture is empty or the length is not 3·H·W.
    pub fn new(width: u32, height: u32, rgb: Vec<u8>) -> Result<Self, EngineError> {
        check_length(width, height, 3, rgb.len())?;
        Ok(Self { width, height, rgb })
    }

    /// Rounds a rendered picture `[H, W, 4]` to the nearest of 256 levels; the fourth channel is dropped.
    ///
    /// Truncation would cost 52.9 dB by itself, more than a faint mark; rounding costs 58.9 dB.
    /// Values outside \[0, 1\] are clamped.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for a NaN or infinite colour; [`EngineError::Usage`] for a wrong length.
    pub fn from_rgba32f(width: u32, height: u32, pixels: &[f32]) -> Result<Self, EngineError> {
        check_length(width, height, 4, pixels.len())?;
        let mut rgb = Vec::with_capacity(pixels.len() / 4 * 3);
        for (at, pixel) in pixels.chunks_exact(4).enumerate() {
            for &colour in &pixel[..3] {
                if !colour.is_finite() {
                    let width = width as usize;
                    return Err(EngineError::NotFinite {
                        what: format!("rendered pixel ({}, {})", at % width, at / width),
                        got: f64::from(colour),
                    });
                }
                rgb.push(round_to_u8(colour));
            }
        }
        Ok(Self { width, height, rgb })
    }

    /// Width in pixels.
    #[must_use]
    pub const fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    #[must_use]
    pub const fn height(&self) -> u32 {
        self.height
    }

    /// Samples `[H, W, 3]`.
    #[must_use]
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// The picture as `[H, W, 4]` with colours in \[0, 1\] and a fourth channel of 0.
    #[must_use]
    pub fn to_rgba32f(&self) -> Vec<f32> {
        let unit = |level: u8| f32::from(level) / 255.0;
        self.rgb.chunks_exact(3).flat_map(|p| [unit(p[0]), unit(p[1]), unit(p[2]), 0.0]).collect()
    }

    /// Lays RGBA samples `[H, W, 4]` with straight alpha over a background.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the picture is empty or the length is not 4·H·W.
    pub fn from_rgba8(width: u32, height: u32, rgba: &[u8], background: [u8; 3]) -> Result<Self, EngineError> {
        check_length(width, height, 4, rgba.len())?;
        let over = |colour: u8, behind: u8, alpha: u8| {
            let (alpha, rest) = (u32::from(alpha), 255 - u32::from(alpha));
            let sum = u32::from(colour) * alpha + u32::from(behind) * rest;
            u8::try_from((sum + 127) / 255).expect("a weighted mean of bytes is a byte")
        };
        let rgb = rgba
            .chunks_exact(4)
            .flat_map(|p| std::array::from_fn::<u8, 3, _>(|c| over(p[c], background[c], p[3])))
            .collect();
        Ok(Self { width, height, rgb })
    }
}

fn check_length(width: u32, height: u32, channels: u64, got: usize) -> Result<(), EngineError> {
    let expected = u64::from(width) * u64::from(height) * channels;
    if expected > 0 && got as u64 == expected {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "picture".to_owned(),
        got: format!("{got} samples"),
        expected: format!("{height} x {width} x {channels} samples, at least one pixel"),
    })
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a rounded number in 0..=255 is exact in u8"
)]
fn round_to_u8(colour: f32) -> u8 {
    (colour.clamp(0.0, 1.0) * 255.0).round() as u8
}

/// Whether a video decoded without complaint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Integrity {
    /// It did, or the source was a folder of pictures.
    Intact,
    /// The decoder reported errors and went on; frames may be concealed or missing.
    Damaged {
        /// The decoder's own words.
        messages: String,
    },
}

/// Frames per second as a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRate {
    /// Frames.
    pub frames: NonZeroU32,
    /// Per this many seconds.
    pub seconds: NonZeroU32,
}

impl FrameRate {
    /// Whole frames per second.
    #[must_use]
    pub const fn per_second(frames: NonZeroU32) -> Self {
        Self { frames, seconds: NonZeroU32::MIN }
    }
}
