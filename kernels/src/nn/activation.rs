//! Pointwise activations.

use super::check::{as_u32, expect_len, expect_multiple};
use crate::error::KernelError;
use crate::registry::nn::{activation_bwd, activation_fwd};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/activation";

/// Which function is applied to every element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Activation {
    /// x
    #[default]
    Identity,
    /// max(0, x)
    Relu,
    /// x σ(1.702 x), as in OpenAI's CLIP
    QuickGelu,
    /// x Φ(x) with the error function
    Gelu,
}

impl Activation {
    /// Code understood by `glsl/lib/activation.glsl`.
    pub(crate) fn code(self) -> u32 {
        match self {
            Self::Identity => 0,
            Self::Relu => 1,
            Self::QuickGelu => 2,
            Self::Gelu => 3,
        }
    }
}

/// `y = act(x)`.
///
/// # Shapes
/// in `x` \[n\] · out `y` \[n\] (=); n a multiple of 4
/// # Equation: see [`Activation`]; error function by Abramowitz & Stegun 1964, 7.1.26
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    activation: Activation,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let n4 = quads(x.len())?;
    expect_len(KERNEL, "y", y.len(), x.len(), "like x")?;
    let bind = activation_fwd::Bind { x_tex: x, y };
    let spec = activation_fwd::Spec { kind: activation.code() };
    rec.dispatch_spec(bind, activation_fwd::Params { n4: as_u32(n4) }, spec, Grid::threads(n4))
}

/// `v_x = v_y act'(x)`.
///
/// # Shapes
/// in `x` \[n\] (the forward pass's input) · `v_y` \[n\] · out `v_x` \[n\] (=); n a multiple of 4
/// # Equation: derivative of [`Activation`]; 0 for ReLU at 0
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    activation: Activation,
    x: &Buffer<f32>,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let n4 = quads(x.len())?;
    expect_len(KERNEL, "v_y", v_y.len(), x.len(), "like x")?;
    expect_len(KERNEL, "v_x", v_x.len(), x.len(), "like x")?;
    let bind = activation_bwd::Bind { x_tex: x, v_y_tex: v_y, v_x };
    let spec = activation_bwd::Spec { kind: activation.code() };
    rec.dispatch_spec(bind, activation_bwd::Params { n4: as_u32(n4) }, spec, Grid::threads(n4))
}

fn quads(len: usize) -> Result<usize, KernelError> {
    if len > 0 {
        expect_multiple(KERNEL, "x", len, 4)?;
    }
    Ok(len / 4)
}
