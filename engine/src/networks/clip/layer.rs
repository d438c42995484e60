//! Pieces of a transformer layer on the device: linear maps, norms, the MLP.

use guard4d_kernels::nn::activation::{self, Activation};
use guard4d_kernels::nn::layer_norm::{self, LayerNorm, Rows};
use guard4d_kernels::nn::matmul::{self, Epilogue, Product};
use guard4d_kernels::nn::pack::{PackedWeight, Precision};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::weights::Weights;
use crate::error::EngineError;

/// Whether a tower's inputs will be asked for gradients; without, transposed weights and activations are not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TowerPurpose {
    /// Features only.
    Features,
    /// Features and the gradient to the input.
    InputGradient,
    /// The same in less memory: the backward pass computes most activations again, with the same kernels from the same
    /// inputs and so to the same bits, instead of finding them kept.
    LeanInputGradient,
}

impl TowerPurpose {
    /// Whether gradients are asked for.
    #[must_use]
    pub fn has_gradient(self) -> bool {
        self != Self::Features
    }
}

/// Where weights come from and what they are for.
#[derive(Clone, Copy)]
pub(super) struct Loader<'a> {
    pub(super) device: &'a Device,
    pub(super) weights: &'a Weights,
    pub(super) purpose: TowerPurpose,
    /// Of the matrices and of the attention between them; norms and biases are floats.
    pub(super) precision: Precision,
}

impl Loader<'_> {
    /// The norm stored as `name.weight` and `name.bias`.
    pub(super) fn norm(&self, name: &str, eps: f32) -> Result<LayerNorm, EngineError> {
        let gamma = self.weights.get(&format!("{name}.weight"))?;
        let beta = self.weights.get(&format!("{name}.bias"))?;
        Ok(LayerNorm::new(self.device, name, gamma, beta, eps)?)
    }

    /// The linear maps `prefix.name` for all `names`, stacked into one, with their biases.
    pub(super) fn linear(&self, prefix: &str, names: &[&str], inputs: usize) -> Result<Linear, EngineError> {
        let keys = |part: &str| names.iter().map(|n| format!("{prefix}.{n}.{part}")).collect::<Vec<_>>();
        let weight = self.weights.stacked(&keys("weight"))?;
        let bias = self.weights.stacked(&keys("bias"))?;
        let name = format!("{prefix}.{}", names.join("+"));
        Ok(self.matrix(&name, &weight, Some(&bias), inputs)?)
    }

    /// A linear map from plain arrays.
    pub(super) fn matrix(
        &self,
        name: &str,
        weight: &[f32],
        bias: Option<&[f32]>,
        inputs: usize,
    ) -> Result<Linear, KernelError> {
        let outputs = weight.len() / inputs;
        let adjoint = if self.purpose.has_gradient() {
            let name = format!("{name}.adjoint");
            Some(PackedWeight::transposed(self.device, &name, weight, inputs, outputs, self.precision)?)
        } else {
            None
        };
        Ok(Linear {
            weight: PackedWeight::in_precision(self.device, name, weight, outputs, inputs, self.precision)?,
            bias: bias.map(|b| self.device.buffer_from(&format!("{name}.bias"), b)).transpose()?,
            adjoint,
        })
    }
}

/// y = x Wᵀ + b, and its adjoint where the tower was loaded for gradients.
#[derive(Debug)]
pub(super) struct Linear {
    weight: PackedWeight,
    bias: Option<Buffer<f32>>,
    adjoint: Option<PackedWeight>,
}

impl Linear {
    pub(super) fn forward(
        &self,
        rec: &mut Recorder,
        x: &Buffer<f32>,
        epilogue: Epilogue,
        y: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        let rows = x.len() / self.weight.k();
        let product = Product { a: x, rows, weight: &self.weight, bias: self.bias.as_ref(), epilogue };
        matmul::forward(rec, &product, y)
    }

    /// `v_x = v_y W`, then the epilogue.
    pub(super) fn backward(
        &self,
        rec: &mut Recorder,
        v_y: &Buffer<f32>,
        epilogue: Epilogue,
        v_x: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        let adjoint = self.adjoint.as_ref().expect("workspaces with gradients are made from towers with adjoints only");
        let rows = v_y.len() / adjoint.k();
        matmul::forward(rec, &Product { epilogue, ..Product::plain(v_y, rows, adjoint) }, v_x)
    }
}

/// No epilogue.
pub(super) const PLAIN: Epilogue<'static> = Epilogue::Activate(Activation::Identity);

/// Second half of a layer: x + fc2(act(fc1(norm(x)))).
#[derive(Debug)]
pub(super) struct Mlp {
    norm: LayerNorm,
    fc1: Linear,
    fc2: Linear,
    activation: Activation,
}

/// What the MLP leaves for its backward pass, and its scratch.
#[derive(Debug)]
pub(super) struct MlpState {
    /// Input `[rows, width]`.
    pub(super) x: Buffer<f32>,
    /// Input of the activation `[rows, inner]`; empty when no gradient is wanted.
    pre: Buffer<f32>,
}

impl MlpState {
    pub(super) fn new(
        device: &Device,
        name: &str,
        rows: usize,
        width: usize,
        inner: usize,
        purpose: TowerPurpose,
    ) -> Result<Self, KernelError> {
        let kept = if purpose.has_gradient() { rows * inner } else { 0 };
        Ok(Self {
            x: device.buffer(&format!("{name}.x_mid"), rows * width)?,
            pre: device.buffer(&format!("{name}.pre"), kept)?,
        })
    }
}

/// Buffers that layers of the same number of rows share.
#[derive(Debug)]
pub(super) struct MlpScratch {
    /// `[rows, width]`: output of a norm, or its gradient.
    pub(super) hidden: Buffer<f32>,
    /// `[rows, inner]`: output of the activation, or the gradient of its input.
    inner: Buffer<f32>,
}

impl MlpScratch {
    pub(super) fn new(
        device: &Device,
        name: &str,
        rows: usize,
        width: usize,
        inner: usize,
    ) -> Result<Self, KernelError> {
        Ok(Self {
            hidden: device.buffer(&format!("{name}.hidden"), rows * width)?,
            inner: device.buffer(&format!("{name}.inner"), rows * inner)?,
        })
    }
}

impl Mlp {
    pub(super) fn load(
        loader: &Loader,
        prefix: &str,
        width: usize,
        inner: usize,
        activation: Activation,
        eps: f32,
    ) -> Result<Self, EngineError> {
        Ok(Self {
            norm: loader.norm(&format!("{prefix}.layer_norm2"), eps)?,
            fc1: loader.linear(prefix, &["mlp.fc1"], width)?,
            fc2: loader.linear(prefix, &["mlp.fc2"], inner)?,
            activation,
        })
    }

    /// `y = x + fc2(act(fc1(norm(x))))` for `x = state.x`.
    pub(super) fn forward(
        &self,
        rec: &mut Recorder,
        state: &mut MlpState,
        scratch: &mut MlpScratch,
        y: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        if state.pre.is_empty() {
            self.normalise(rec, state, scratch)?;
            self.fc1.forward(rec, &scratch.hidden, Epilogue::Activate(self.activation), &mut scratch.inner)?;
        } else {
            self.before_activation(rec, state, scratch)?;
            activation::forward(rec, self.activation, &state.pre, &mut scratch.inner)?;
        }
        self.fc2.forward(rec, &scratch.inner, Epilogue::Add(&state.x), y)
    }

    /// `state.pre = fc1(norm(state.x))`: the part of the forward pass that the backward one reads.
    pub(super) fn before_activation(
        &self,
        rec: &mut Recorder,
        state: &mut MlpState,
        scratch: &mut MlpScratch,
    ) -> Result<(), KernelError> {
        self.normalise(rec, state, scratch)?;
        self.fc1.forward(rec, &scratch.hidden, PLAIN, &mut state.pre)
    }

    fn normalise(&self, rec: &mut Recorder, state: &MlpState, scratch: &mut MlpScratch) -> Result<(), KernelError> {
        let rows = Rows::all(state.x.len() / self.norm.width());
        layer_norm::forward(rec, &self.norm, &state.x, rows, &mut scratch.hidden)
    }

    /// Gradient to `state.x`, residual path included.
    pub(super) fn backward(
        &self,
        rec: &mut Recorder,
        state: &MlpState,
        v_y: &Buffer<f32>,
        scratch: &mut MlpScratch,
        v_x: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        let rows = Rows::all(state.x.len() / self.norm.width());
        self.fc2.backward(rec, v_y, Epilogue::Grad(self.activation, &state.pre), &mut scratch.inner)?;
        self.fc1.backward(rec, &scratch.inner, PLAIN, &mut scratch.hidden)?;
        let upstream = layer_norm::Upstream { x: &state.x, v_y: &scratch.hidden, v_residual: Some(v_y) };
        layer_norm::backward(rec, &self.norm, &upstream, rows, v_x)
    }
}
