//! Structural dissimilarity to a reference clip whose moments are kept, with its gradient.

use super::sum::{LANES, PARTIALS_PER_GROUP, finish};
use super::term::Term;
use crate::error::KernelError;
use crate::image::CHANNELS;
use crate::image::resize::ImageSize;
use crate::registry::loss::{ssim_bwd, ssim_columns, ssim_fwd, ssim_reference, ssim_rows};
use crate::shape::{dim, dim_signed, expect_len, require_len};
use crate::vk::{Buffer, Device, Grid, Recorder};

const KERNEL: &str = "loss/ssim";
/// Standard deviation of the window in pixels.
const SIGMA_PX: f64 = 1.5;
/// Taps on either side of the centre.
const RADIUS: usize = 5;
/// (0.01)² and (0.03)², for colours in \[0, 1\].
const C1: f32 = 0.0001;
/// See [`C1`].
const C2: f32 = 0.0009;
/// Outputs of an invocation along the window.
const RUN: i32 = 8;

/// Half of the normalised Gaussian window, from the centre outwards.
#[allow(clippy::cast_possible_truncation, reason = "the window is used in f32")]
fn window() -> [f32; RADIUS + 1] {
    let tap = |k: usize| (-((k * k) as f64) / (2.0 * SIGMA_PX * SIGMA_PX)).exp();
    let total = tap(0) + 2.0 * (1..=RADIUS).map(tap).sum::<f64>();
    std::array::from_fn(|k| (tap(k) / total) as f32)
}

/// Fills the window fields of a `Spec`.
macro_rules! window_spec {
    ($kernel:ident $(, $field:ident: $value:expr)*) => {{
        let [g0, g1, g2, g3, g4, g5] = window();
        $kernel::Spec { g0, g1, g2, g3, g4, g5, run: RUN $(, $field: $value)* }
    }};
}

/// Windowed means and variances of a reference clip, computed once.
#[derive(Debug)]
pub struct SsimReference {
    size: ImageSize,
    frames: usize,
    moments: Buffer<f32>,
}

impl SsimReference {
    /// Room for the moments of a clip; [`prepare`] computes them.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, size: ImageSize, frames: usize) -> Result<Self, KernelError> {
        let moments = frames * size.height * size.width * 2 * CHANNELS;
        Ok(Self { size, frames, moments: device.buffer("ssim.moments", moments)? })
    }

    /// Bytes of device memory.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<f32>() * self.moments.len()
    }

    fn expect_clip(&self, name: &'static str, clip: &Buffer<f32>) -> Result<(), KernelError> {
        expect_len(KERNEL, name, clip, self.frames * self.size.height * self.size.width * CHANNELS)
    }
}

/// A clip, the clip that it is compared with, and the moments of the latter.
#[derive(Clone, Copy, Debug)]
pub struct SsimPair<'a> {
    /// Clip that gets the gradient `[F,H,W,4]`.
    pub clip: &'a Buffer<f32>,
    /// Reference clip `[F,H,W,4]`.
    pub reference: &'a Buffer<f32>,
    /// Prepared from the reference clip.
    pub moments: &'a SsimReference,
}

/// Working memory for frames of one size.
#[derive(Debug)]
pub struct SsimScratch {
    rows: Buffer<f32>,
    slopes: Buffer<f32>,
    partial: Buffer<f32>,
}

impl SsimScratch {
    /// Memory for one frame at a time, and the partial sums of `frames` frames.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, size: ImageSize, frames: usize) -> Result<Self, KernelError> {
        let planes = size.height * size.width * 3 * CHANNELS;
        Ok(Self {
            rows: device.buffer("ssim.rows", planes)?,
            slopes: device.buffer("ssim.slopes", planes)?,
            partial: device.buffer("ssim.partial", partials(size) * frames)?,
        })
    }

    fn check(&self, size: ImageSize, frames: usize) -> Result<(), KernelError> {
        expect_len(KERNEL, "scratch.rows", &self.rows, size.height * size.width * 3 * CHANNELS)?;
        require_len(KERNEL, "scratch.partial", self.partial.len(), partials(size) * frames)
    }
}

fn column_groups(size: ImageSize) -> (usize, usize) {
    (size.width.div_ceil(LANES), runs(size.height))
}

fn runs(n: usize) -> usize {
    n.div_ceil(RUN.unsigned_abs() as usize)
}

fn partials(size: ImageSize) -> usize {
    let (x, y) = column_groups(size);
    x * y * PARTIALS_PER_GROUP
}

fn row_grid(size: ImageSize) -> Grid {
    Grid::threads(size.height * runs(size.width))
}

fn column_grid(size: ImageSize) -> Grid {
    let (x, y) = column_groups(size);
    Grid::groups(dim(x), dim(y), 1)
}

/// Computes the moments of the reference clip.
///
/// # Shapes
/// in `clip` \[F,H,W,4\] · out `moments` of \[F,H,W\] (=) · `scratch` of \[H,W\] (=)
/// # Equation: windowed mean μ and variance E\[y²\] − μ²
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn prepare(
    rec: &mut Recorder,
    clip: &Buffer<f32>,
    moments: &mut SsimReference,
    scratch: &mut SsimScratch,
) -> Result<(), KernelError> {
    let size = moments.size;
    moments.expect_clip("reference", clip)?;
    scratch.check(size, 0)?;
    let (height, width) = (dim_signed(size.height), dim_signed(size.width));
    for frame in 0..moments.frames {
        let first_px = dim_signed(frame * size.height * size.width);
        let params = ssim_rows::Params { height, width, first_px };
        let bind = ssim_rows::Bind { x: clip, y: clip, rows: &mut scratch.rows };
        rec.dispatch_spec(bind, params, window_spec!(ssim_rows, reference: 1), row_grid(size))?;
        let params = ssim_reference::Params { height, width, first_px };
        let bind = ssim_reference::Bind { rows: &scratch.rows, moments: &mut moments.moments };
        rec.dispatch_spec(bind, params, window_spec!(ssim_reference), column_grid(size))?;
    }
    Ok(())
}

/// Mean of 1 − SSIM over a clip and its gradient.
///
/// # Shapes
/// in `pair` \[F,H,W,4\] · out `v_clip` \[F,H,W,4\] (=) or (+=), fourth channel 0 ·
/// `term.values`, one element (=): the mean over F·H·W·3
/// # Equation: Wang et al. 2004, eq. 13; 11×11 Gaussian window, σ = 1.5, zero padding. Computed from the
/// difference of the clips, so that it keeps its precision where they are nearly the same.
/// # Determinism: bitwise; sums in a fixed order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn step(
    rec: &mut Recorder,
    pair: &SsimPair<'_>,
    v_clip: &mut Buffer<f32>,
    term: Term<'_>,
    scratch: &mut SsimScratch,
) -> Result<(), KernelError> {
    let SsimPair { clip, reference, moments } = *pair;
    let SsimReference { size, frames, .. } = *moments;
    for (name, buffer) in [("clip", clip), ("reference", reference), ("v_clip", &*v_clip)] {
        moments.expect_clip(name, buffer)?;
    }
    scratch.check(size, frames)?;
    term.slots(KERNEL, 1)?;
    let pixels = size.height * size.width;
    let mean = 1.0 / ((frames * pixels).max(1) as f32 * 3.0);
    for frame in 0..frames {
        slopes(rec, frame, pair, scratch)?;
        let params = ssim_bwd::Params {
            height: dim_signed(size.height),
            width: dim_signed(size.width),
            first_px: dim_signed(frame * pixels),
            scale: term.weight * mean,
        };
        let spec = window_spec!(ssim_bwd, accumulate: term.accumulate.flag());
        let before = v_clip.alias();
        let bind = ssim_bwd::Bind { rows: &scratch.rows, x: clip, y: reference, v_before: &before, v_x: v_clip };
        rec.dispatch_spec(bind, params, spec, row_grid(size))?;
    }
    finish(rec, &scratch.partial, 0..partials(size) * frames, mean, term.values, term.slot)
}

/// Partial sums of one frame, and its vertically windowed slopes in `scratch.rows`.
fn slopes(rec: &mut Recorder, frame: usize, pair: &SsimPair<'_>, scratch: &mut SsimScratch) -> Result<(), KernelError> {
    let SsimPair { clip, reference, moments } = *pair;
    let size = moments.size;
    let (height, width) = (dim_signed(size.height), dim_signed(size.width));
    let first_px = dim_signed(frame * size.height * size.width);
    let params = ssim_rows::Params { height, width, first_px };
    let bind = ssim_rows::Bind { x: clip, y: reference, rows: &mut scratch.rows };
    rec.dispatch_spec(bind, params, window_spec!(ssim_rows, reference: 0), row_grid(size))?;
    let first_partial = dim(frame * partials(size));
    let params = ssim_fwd::Params { height, width, first_px, first_partial, c1: C1, c2: C2 };
    let bind = ssim_fwd::Bind {
        rows: &scratch.rows,
        moments: &moments.moments,
        slopes: &mut scratch.slopes,
        partial: &mut scratch.partial,
    };
    rec.dispatch_spec(bind, params, window_spec!(ssim_fwd), column_grid(size))?;
    let bind = ssim_columns::Bind { slopes: &scratch.slopes, rows: &mut scratch.rows };
    rec.dispatch_spec(bind, ssim_columns::Params { height, width }, window_spec!(ssim_columns), column_grid(size))
}
