//! One tap of LPIPS: the distance of two pictures' features, with its gradient.

use super::sum::{LANES, PARTIALS_PER_GROUP, finish};
use super::term::Term;
use crate::error::KernelError;
use crate::registry::loss::lpips_step;
use crate::shape::{dim, dim_signed, expect_len, require_len};
use crate::vk::{Buffer, Device, Grid, Recorder};

const KERNEL: &str = "loss/lpips";
/// Added to a feature's length before it divides (Zhang et al. 2018, version 0.1 of their code).
pub const EPS: f64 = 1e-10;

/// Partial sums of one tap.
#[derive(Debug)]
pub struct LpipsSums {
    partial: Buffer<f32>,
}

impl LpipsSums {
    /// Memory for taps of at most `rows` pixels.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, rows: usize) -> Result<Self, KernelError> {
        Ok(Self { partial: device.buffer("lpips.partial", partials(rows))? })
    }
}

fn partials(rows: usize) -> usize {
    rows.div_ceil(LANES) * PARTIALS_PER_GROUP
}

/// Features of one tap.
#[derive(Clone, Copy, Debug)]
pub struct Tap<'a> {
    /// Of the pictures `[rows, channels]`, behind a ReLU.
    pub features: &'a Buffer<f32>,
    /// Of what they are compared with, likewise.
    pub reference: &'a Buffer<f32>,
    /// Weight of each channel `[channels]`.
    pub weight: &'a Buffer<f32>,
    /// Pixels of all pictures.
    pub rows: usize,
    /// Pixels that the mean is taken over, those of other calls among them.
    pub mean_over: usize,
}

/// Value and gradient of one tap.
///
/// # Shapes
/// in `tap` · out `v_features` \[rows, channels\] (=) the gradient of the ReLU's input: where a feature is above 0,
/// what was in `v_features` with [`Accumulate::Add`](crate::shape::Accumulate) plus the own gradient, else 0 ·
/// `term.values`, one element (=)
/// # Equation: Σ w (x / (|x| + ε) − y / (|y| + ε))² / `mean_over` over pixels and channels (Zhang et al. 2018, eq. 1);
/// ε = [`EPS`]
/// # Determinism: bitwise; sums in a fixed order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn step(
    rec: &mut Recorder,
    tap: &Tap<'_>,
    v_features: &mut Buffer<f32>,
    term: Term<'_>,
    sums: &mut LpipsSums,
) -> Result<(), KernelError> {
    let Tap { features, reference, weight, rows, mean_over } = *tap;
    let channels = weight.len();
    if channels == 0 || !channels.is_multiple_of(4) {
        let expected = "a positive multiple of 4".to_owned();
        return Err(KernelError::Shape { kernel: KERNEL, buffer: "weight", got: channels.to_string(), expected });
    }
    expect_len(KERNEL, "features", features, rows * channels)?;
    expect_len(KERNEL, "reference", reference, rows * channels)?;
    expect_len(KERNEL, "v_features", v_features, rows * channels)?;
    require_len(KERNEL, "sums", sums.partial.len(), partials(rows))?;
    term.slots(KERNEL, 1)?;
    let mean = 1.0 / mean_over.max(1) as f32;
    let params =
        lpips_step::Params { rows: dim_signed(rows), channels: dim_signed(channels), scale: term.weight * mean };
    #[allow(clippy::cast_possible_truncation, reason = "the shader computes in f32")]
    let spec = lpips_step::Spec { accumulate: term.accumulate.flag(), eps: EPS as f32 };
    let before = v_features.alias();
    let bind =
        lpips_step::Bind { features, reference, weight, v_before: &before, v_features, partial: &mut sums.partial };
    rec.dispatch_spec(bind, params, spec, Grid::groups(dim(rows.div_ceil(LANES)), 1, 1))?;
    finish(rec, &sums.partial, 0..partials(rows), mean, term.values, term.slot)
}
