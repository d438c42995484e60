//! Distortions on the device, each with its gradient.

use guard4d_kernels::image::jpeg::{self, JpegQuality};
use guard4d_kernels::image::noise::{self, Noise};
use guard4d_kernels::image::resize::{Blur, ImageSize, ResizePlan};
use guard4d_kernels::image::warp::{self, Sampling, Warp};
use guard4d_kernels::image::{CHANNELS, chroma420, colour_map};
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::kind::{Distortion, DistortionKind};
use super::resizer::Resizer;

/// Standard deviations at which a blur is cut off.
const BLUR_REACH: f64 = 3.0;

/// One distortion of a [`DistortionLayer`], as it is applied once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Number in the layer's list.
    pub index: usize,
    /// Where between its strengths, 0 to 1.
    pub share: f64,
    /// Seed of its noise.
    pub seed: u64,
    /// Stream of its noise.
    pub stream: u32,
}

/// What a distortion keeps on the device.
#[derive(Debug)]
enum Tables {
    None,
    Rescale(Box<Rescale>),
    Filter(Box<Resizer>),
    Jpeg(JpegQuality),
}

/// To a smaller size and back.
#[derive(Debug)]
struct Rescale {
    down: Resizer,
    up: Resizer,
    small: Buffer<f32>,
}

/// Distortions of clips of one size.
#[derive(Debug)]
pub struct DistortionLayer {
    clip: ClipShape,
    list: Vec<(Distortion, Tables)>,
    /// Between two passes of one distortion; full size, or empty where none has two.
    between: Buffer<f32>,
}

impl DistortionLayer {
    /// Prepares a list of distortions.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, clip: ClipShape, list: &[Distortion]) -> Result<Self, KernelError> {
        let has_codec = list.iter().any(|d| d.kind() == DistortionKind::Codec);
        let floats = if has_codec { clip.pixels() * CHANNELS } else { 0 };
        let tables = |d: &Distortion| Ok((*d, Tables::new(device, clip, d)?));
        Ok(Self {
            clip,
            list: list.iter().map(tables).collect::<Result<_, KernelError>>()?,
            between: device.buffer("distortion.between", floats)?,
        })
    }

    /// Number of distortions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Distorts a clip.
    ///
    /// # Shapes
    /// in `x` \[F,H,W,4\] in \[0, 1\] · out `y` likewise (=), neither clamped nor rounded to 8 bits but by noise, which
    /// clamps
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    ///
    /// # Panics
    /// Never for a `drawn` of this layer's list.
    pub fn forward(
        &mut self,
        rec: &mut Recorder,
        drawn: Drawn,
        x: &Buffer<f32>,
        y: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        let Self { clip, list, between } = self;
        let (distortion, tables) = &mut list[drawn.index];
        let strength = distortion.strength(drawn.share);
        match tables {
            Tables::Rescale(rescale) => {
                let Rescale { down, up, small } = rescale.as_mut();
                down.forward(rec, x, small)?;
                up.forward(rec, small, y)
            }
            Tables::Filter(blur) if distortion.kind() == DistortionKind::Codec => {
                chroma420::forward(rec, *clip, x, between)?;
                blur.forward(rec, between, y)
            }
            Tables::Filter(blur) => blur.forward(rec, x, y),
            Tables::Jpeg(quality) => jpeg::forward(rec, *clip, quality, x, y),
            Tables::None => match distortion.kind() {
                DistortionKind::Noise => noise::forward(rec, &noise_of(strength, drawn), x, y),
                DistortionKind::Brightness => colour_map::forward(rec, &brightness(strength), x, y),
                _ => match warp_of(distortion.kind(), *clip, strength) {
                    Some(warp) => warp::forward(rec, *clip, &warp, x, y),
                    None => rec.copy(x, 0, y, 0, x.len()),
                },
            },
        }
    }

    /// Gradient to the clip as it was given to [`Self::forward`]. JPEG's rounding passes it.
    ///
    /// # Shapes
    /// in `x` and `v_y` \[F,H,W,4\] · out `v_x` likewise (=)
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    ///
    /// # Panics
    /// Never for a `drawn` of this layer's list.
    pub fn backward(
        &mut self,
        rec: &mut Recorder,
        drawn: Drawn,
        x: &Buffer<f32>,
        v_y: &Buffer<f32>,
        v_x: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        let Self { clip, list, between } = self;
        let (distortion, tables) = &mut list[drawn.index];
        let strength = distortion.strength(drawn.share);
        match tables {
            Tables::Rescale(rescale) => {
                let Rescale { down, up, small } = rescale.as_mut();
                up.backward(rec, v_y, small)?;
                down.backward(rec, small, v_x)
            }
            Tables::Filter(blur) if distortion.kind() == DistortionKind::Codec => {
                blur.backward(rec, v_y, between)?;
                chroma420::backward(rec, *clip, between, v_x)
            }
            Tables::Filter(blur) => blur.backward(rec, v_y, v_x),
            Tables::Jpeg(_) => jpeg::backward(rec, *clip, v_y, v_x),
            Tables::None => match distortion.kind() {
                DistortionKind::Noise => noise::backward(rec, &noise_of(strength, drawn), x, v_y, v_x),
                DistortionKind::Brightness => colour_map::backward(rec, &brightness(strength), v_y, v_x),
                _ => match warp_of(distortion.kind(), *clip, strength) {
                    Some(warp) => warp::backward(rec, *clip, &warp, v_y, v_x),
                    None => rec.copy(v_y, 0, v_x, 0, v_y.len()),
                },
            },
        }
    }
}

impl Tables {
    fn new(device: &Device, clip: ClipShape, distortion: &Distortion) -> Result<Self, KernelError> {
        let size = ImageSize { height: clip.height, width: clip.width };
        let strength = distortion.strength(0.0);
        match distortion.kind() {
            DistortionKind::Rescale => {
                let part = |n: usize| scaled(n, strength);
                let less = ImageSize { height: part(size.height), width: part(size.width) };
                let resizer = |from, to| Resizer::new(device, clip.frames, ResizePlan::new(device, from, to)?);
                let floats = clip.frames * less.height * less.width * CHANNELS;
                let small = device.buffer("distortion.small", floats)?;
                let rescale = Rescale { down: resizer(size, less)?, up: resizer(less, size)?, small };
                Ok(Self::Rescale(Box::new(rescale)))
            }
            DistortionKind::Blur | DistortionKind::Codec => {
                let blur = Blur { sigma: strength, radius: whole(BLUR_REACH * strength) };
                let resizer = Resizer::new(device, clip.frames, ResizePlan::blur(device, size, blur)?)?;
                Ok(Self::Filter(Box::new(resizer)))
            }
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a whole number from 1 to 100")]
            DistortionKind::Jpeg => Ok(Self::Jpeg(JpegQuality::new(device, strength as u8)?)),
            DistortionKind::Identity
            | DistortionKind::Noise
            | DistortionKind::Rotation
            | DistortionKind::Crop
            | DistortionKind::Mirror
            | DistortionKind::Brightness => Ok(Self::None),
        }
    }
}

/// Pixels along a side of `n` that is made smaller.
fn scaled(n: usize, share: f64) -> usize {
    whole((n as f64 * share).round()).clamp(1, n)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "lengths in pixels, not negative")]
fn whole(length: f64) -> usize {
    length.ceil() as usize
}

fn noise_of(sigma: f64, drawn: Drawn) -> Noise {
    #[allow(clippy::cast_possible_truncation, reason = "a standard deviation up to 1")]
    let sigma = sigma as f32;
    Noise { sigma, seed: drawn.seed, stream: drawn.stream }
}

/// Every colour times `factor`.
#[allow(clippy::cast_possible_truncation, reason = "a factor up to 4")]
pub(crate) fn brightness(factor: f64) -> colour_map::ColourMap {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { factor as f32 } else { 0.0 }))
}

fn warp_of(kind: DistortionKind, clip: ClipShape, strength: f64) -> Option<Warp> {
    match kind {
        DistortionKind::Rotation => Some(Warp::rotation(clip, strength, Sampling::Bilinear, [0.0; 3])),
        DistortionKind::Crop => Some(Warp::crop(clip, strength)),
        DistortionKind::Mirror => Some(Warp::mirror(clip)),
        _ => None,
    }
}
