//! Structural similarity against a reference frame whose moments are kept, with its gradient.

use crate::image::CHANNELS;
use crate::image::resize::ImageSize;
use crate::loss::Term;
use crate::loss::sum::{LANES, PARTIALS_PER_GROUP, finish};
use crate::registry::loss::{ssim_bwd, ssim_columns, ssim_fwd, ssim_reference, ssim_rows};
use crate::shape::{dim, dim_signed, expect_len};
use crate::{Buffer, Device, Grid, KernelError, Recorder};

const KERNEL: &str = "loss/ssim";
/// Standard deviation of the window in pixels.
const SIGMA_PX: f64 = 1.5;
/// Taps on either side of the centre.
const RADIUS: usize = 5;
/// (0.01)² and (0.03)², for colours in [0, 1].
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

/// A reference frame and its windowed mean and variance, computed once.
#[derive(Debug)]
pub struct SsimReference {
    size: ImageSize,
    image: Buffer<f32>,
    moments: Buffer<f32>,
}

impl SsimReference {
    /// Takes a reference frame `[H,W,4]`; [`prepare`] makes it usable.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when the frame has another size; when memory runs out.
    pub fn new(device: &Device, size: ImageSize, image: Buffer<f32>) -> Result<Self, KernelError> {
        let pixels = size.height * size.width;
        expect_len(KERNEL, "reference", &image, pixels * CHANNELS)?;
        Ok(Self { size, image, moments: device.buffer("ssim.moments", pixels * 2 * CHANNELS)? })
    }

    /// The frame itself.
    #[must_use]
    pub fn image(&self) -> &Buffer<f32> {
        &self.image
    }
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
        expect_len(KERNEL, "scratch.partial", &self.partial, partials(size) * frames)
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

fn rows(
    rec: &mut Recorder,
    size: ImageSize,
    (x, x_px): (&Buffer<f32>, usize),
    y: &Buffer<f32>,
    rows: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let params = ssim_rows::Params {
        height: dim_signed(size.height),
        width: dim_signed(size.width),
        x_px: dim_signed(x_px),
        y_px: 0,
    };
    let grid = Grid::threads(size.height * runs(size.width));
    rec.dispatch_spec(ssim_rows::Bind { x, y, rows }, params, window_spec!(ssim_rows), grid)
}

/// Computes a reference frame's moments.
///
/// # Shapes
/// in/out `reference` of [H,W] · `scratch` of the same size (=)
/// # Equation: windowed mean μ and variance E[y²] − μ²
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn prepare(
    rec: &mut Recorder,
    reference: &mut SsimReference,
    scratch: &mut SsimScratch,
) -> Result<(), KernelError> {
    let size = reference.size;
    expect_len(KERNEL, "scratch.rows", &scratch.rows, size.height * size.width * 3 * CHANNELS)?;
    rows(rec, size, (&reference.image, 0), &reference.image, &mut scratch.rows)?;
    let params = ssim_reference::Params { height: dim_signed(size.height), width: dim_signed(size.width) };
    let (x, y) = column_groups(size);
    let bind = ssim_reference::Bind { rows: &scratch.rows, moments: &mut reference.moments };
    rec.dispatch_spec(bind, params, window_spec!(ssim_reference), Grid::groups(dim(x), dim(y), 1))
}

/// Mean SSIM of a clip and its gradient.
///
/// # Shapes
/// in `clip` [F,H,W,4] · `references` F prepared frames of [H,W] ·
/// out `v_clip` [F,H,W,4] (=) or (+=), fourth channel 0 · `term.values`, one element (=): the mean over F·H·W·3
/// # Equation: Wang et al. 2004, eq. 13; 11×11 Gaussian window, σ = 1.5, zero padding. For the loss
/// 1 − SSIM give a negative weight.
/// # Determinism: bitwise; sums in a fixed order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn step(
    rec: &mut Recorder,
    (clip, references): (&Buffer<f32>, &[&SsimReference]),
    v_clip: &mut Buffer<f32>,
    term: Term<'_>,
    scratch: &mut SsimScratch,
) -> Result<(), KernelError> {
    let Some(size) = references.first().map(|r| r.size) else {
        return expect_len(KERNEL, "clip", clip, 0);
    };
    let (frames, pixels) = (references.len(), size.height * size.width);
    expect_len(KERNEL, "clip", clip, frames * pixels * CHANNELS)?;
    expect_len(KERNEL, "v_clip", v_clip, frames * pixels * CHANNELS)?;
    scratch.check(size, frames)?;
    term.slot(KERNEL)?;
    if let Some(other) = references.iter().find(|r| r.size != size) {
        let (got, expected) = (format!("{:?}", other.size), format!("{size:?} like the first"));
        return Err(KernelError::Shape { kernel: KERNEL, buffer: "references", got, expected });
    }
    let mean = 1.0 / ((frames * pixels).max(1) as f32 * 3.0);
    for (frame, reference) in references.iter().enumerate() {
        slopes(rec, frame, (clip, reference), scratch)?;
        let params = ssim_bwd::Params {
            height: dim_signed(size.height),
            width: dim_signed(size.width),
            x_px: dim_signed(frame * pixels),
            y_px: 0,
            scale: term.weight * mean,
        };
        let spec = window_spec!(ssim_bwd, accumulate: term.accumulate.flag());
        let before = v_clip.alias();
        let bind = ssim_bwd::Bind { rows: &scratch.rows, x: clip, y: &reference.image, v_before: &before, v_x: v_clip };
        rec.dispatch_spec(bind, params, spec, Grid::threads(size.height * runs(size.width)))?;
    }
    finish(rec, (&scratch.partial, partials(size) * frames), mean, (term.values, term.slot))
}

/// Partial sums of one frame, and its vertically windowed slopes in `scratch.rows`.
fn slopes(
    rec: &mut Recorder,
    frame: usize,
    (clip, reference): (&Buffer<f32>, &SsimReference),
    scratch: &mut SsimScratch,
) -> Result<(), KernelError> {
    let size = reference.size;
    let (height, width) = (dim_signed(size.height), dim_signed(size.width));
    let (x, y) = column_groups(size);
    rows(rec, size, (clip, frame * size.height * size.width), &reference.image, &mut scratch.rows)?;
    let first_partial = dim(frame * partials(size));
    let params = ssim_fwd::Params { height, width, first_partial, c1: C1, c2: C2 };
    let bind = ssim_fwd::Bind {
        rows: &scratch.rows,
        moments: &reference.moments,
        slopes: &mut scratch.slopes,
        partial: &mut scratch.partial,
    };
    rec.dispatch_spec(bind, params, window_spec!(ssim_fwd), Grid::groups(dim(x), dim(y), 1))?;
    let bind = ssim_columns::Bind { slopes: &scratch.slopes, rows: &mut scratch.rows };
    let params = ssim_columns::Params { height, width };
    rec.dispatch_spec(bind, params, window_spec!(ssim_columns), Grid::groups(dim(x), dim(y), 1))
}
