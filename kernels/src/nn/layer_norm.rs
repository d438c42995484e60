//! Layer normalisation with constant scale and shift.

use super::check::{as_u32, expect_len, expect_multiple, shape_error};
use crate::error::KernelError;
use crate::registry::nn::{layer_norm_bwd, layer_norm_fwd};
use crate::vk::{Buffer, Device, Grid, Recorder};

const KERNEL: &str = "nn/layer_norm";

/// Scale, shift and epsilon of one normalisation.
#[derive(Debug)]
pub struct LayerNorm {
    gamma: Buffer<f32>,
    beta: Buffer<f32>,
    eps: f32,
}

impl LayerNorm {
    /// Uploads `gamma` and `beta`, both `[width]`, width a multiple of 4.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when the lengths differ or are no multiple of 4; [`KernelError::Allocation`].
    pub fn new(device: &Device, name: &str, gamma: &[f32], beta: &[f32], eps: f32) -> Result<Self, KernelError> {
        expect_multiple(KERNEL, "gamma", gamma.len(), 4)?;
        expect_len(KERNEL, "beta", beta.len(), gamma.len(), "like gamma")?;
        let gamma = device.buffer_from(&format!("{name}.gamma"), gamma)?;
        let beta = device.buffer_from(&format!("{name}.beta"), beta)?;
        Ok(Self { gamma, beta, eps })
    }

    /// Elements of a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.gamma.len()
    }
}

/// Which rows of `x` are normalised: `offset`, `offset + step`, …, `count` of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rows {
    /// How many.
    pub count: usize,
    /// Distance between two of them.
    pub step: usize,
    /// The first one.
    pub offset: usize,
}

impl Rows {
    /// The first `count` rows.
    #[must_use]
    pub fn all(count: usize) -> Self {
        Self { count, step: 1, offset: 0 }
    }

    /// Fails unless `buffer` holds whole rows and all selected ones.
    fn check(self, buffer: &'static str, len: usize, width: usize) -> Result<(), KernelError> {
        let needed = if self.count == 0 { 0 } else { (self.offset + (self.count - 1) * self.step + 1) * width };
        if len >= needed && len.is_multiple_of(width) {
            return Ok(());
        }
        Err(shape_error(
            KERNEL,
            buffer,
            format!("[{len}]"),
            format!("rows of {width}, at least [{needed}] for {self:?}"),
        ))
    }
}

/// `y = (x − mean) / √(var + ε) γ + β` for the selected rows.
///
/// # Shapes
/// in `x` \[.., width\] · out `y` \[rows.count, width\] (=)
/// # Equation: Ba et al. 2016, eq. 4; biased variance
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    norm: &LayerNorm,
    x: &Buffer<f32>,
    rows: Rows,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let width = norm.width();
    rows.check("x", x.len(), width)?;
    expect_len(KERNEL, "y", y.len(), rows.count * width, "rows*width")?;
    let params = layer_norm_fwd::Params {
        rows: as_u32(rows.count),
        width: as_u32(width),
        row_step: as_u32(rows.step),
        row_offset: as_u32(rows.offset),
        eps: norm.eps,
    };
    let bind = layer_norm_fwd::Bind { x_tex: x, gamma_tex: &norm.gamma, beta_tex: &norm.beta, y };
    rec.dispatch(bind, params, Grid::threads(rows.count))
}

/// What the backward pass reads.
#[derive(Clone, Copy, Debug)]
pub struct Upstream<'a> {
    /// Input of the forward pass `[.., width]`.
    pub x: &'a Buffer<f32>,
    /// Gradient of the output `[rows.count, width]`.
    pub v_y: &'a Buffer<f32>,
    /// Added to the result: the gradient that reaches `x` past the norm, shaped like `x`.
    pub v_residual: Option<&'a Buffer<f32>>,
}

/// Gradient to the input; scale and shift are constants.
///
/// # Shapes
/// in [`Upstream`] · out `v_x` like `x` (=), only the selected rows are written
/// # Equation: g = `v_y` γ, `v_x` = (g − mean(g) − x̂ mean(g x̂)) / √(var + ε) + `v_residual`
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    norm: &LayerNorm,
    upstream: &Upstream,
    rows: Rows,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let Upstream { x, v_y, v_residual } = *upstream;
    let width = norm.width();
    rows.check("x", x.len(), width)?;
    expect_len(KERNEL, "v_y", v_y.len(), rows.count * width, "rows*width")?;
    expect_len(KERNEL, "v_x", v_x.len(), x.len(), "like x")?;
    if let Some(residual) = v_residual {
        expect_len(KERNEL, "v_residual", residual.len(), x.len(), "like x")?;
    }
    let params = layer_norm_bwd::Params {
        rows: as_u32(rows.count),
        width: as_u32(width),
        row_step: as_u32(rows.step),
        row_offset: as_u32(rows.offset),
        eps: norm.eps,
    };
    let spec = layer_norm_bwd::Spec { add: u32::from(v_residual.is_some()) };
    let bind = layer_norm_bwd::Bind {
        x_tex: x,
        gamma_tex: &norm.gamma,
        v_y_tex: v_y,
        v_residual_tex: v_residual.unwrap_or(x),
        v_x,
    };
    rec.dispatch_spec(bind, params, spec, Grid::threads(rows.count))
}
