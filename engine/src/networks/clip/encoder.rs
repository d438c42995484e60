//! The transformer of a tower: full layers, then a last one that is evaluated for one token per sequence only.
//!
//! CLIP reads one token of the last layer (class or end token). Keys and values of that layer need all tokens, but its
//! queries, output projection and MLP are computed for that token alone; the result is the same.

use guard4d_kernels::nn::attention::{
    self, AttentionShape, AttentionState, Mask, ProjectionGrads, Projections, Upstream,
};
use guard4d_kernels::nn::layer_norm::{self, LayerNorm, Rows};
use guard4d_kernels::nn::matmul::Epilogue;
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::config::{Sizes, layer_prefix};
use super::layer::{Linear, Loader, Mlp, MlpScratch, MlpState, PLAIN, TowerPurpose};
use crate::error::EngineError;

/// A layer over all tokens.
#[derive(Debug)]
struct FullLayer {
    norm: LayerNorm,
    qkv: Linear,
    out: Linear,
    mlp: Mlp,
}

/// The last layer, evaluated for one token per sequence.
#[derive(Debug)]
struct LastLayer {
    norm: LayerNorm,
    q: Linear,
    kv: Linear,
    out: Linear,
    mlp: Mlp,
}

/// All layers of a tower.
#[derive(Debug)]
pub(super) struct Encoder {
    layers: Vec<FullLayer>,
    last: LastLayer,
    sizes: Sizes,
    purpose: TowerPurpose,
    precision: Precision,
}

/// Sequences of a batch and the token that is read from each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Batch {
    pub(super) sequences: usize,
    pub(super) tokens: usize,
    /// Position of the token that is read.
    pub(super) pick: usize,
    pub(super) mask: Mask,
}

impl Batch {
    fn rows(&self) -> usize {
        self.sequences * self.tokens
    }

    fn picked(&self) -> Rows {
        Rows { count: self.sequences, step: self.tokens, offset: self.pick }
    }
}

impl Encoder {
    pub(super) fn load(loader: &Loader, tower: &str, sizes: Sizes) -> Result<Self, EngineError> {
        let mut layers = Vec::new();
        let mlp = |prefix: &str| Mlp::load(loader, prefix, sizes.width, sizes.inner, sizes.activation, sizes.eps);
        let (q, k, v, out) = ("self_attn.q_proj", "self_attn.k_proj", "self_attn.v_proj", "self_attn.out_proj");
        for layer in 0..sizes.layers - 1 {
            let prefix = layer_prefix(tower, layer);
            layers.push(FullLayer {
                norm: loader.norm(&format!("{prefix}.layer_norm1"), sizes.eps)?,
                qkv: loader.linear(&prefix, &[q, k, v], sizes.width)?,
                out: loader.linear(&prefix, &[out], sizes.width)?,
                mlp: mlp(&prefix)?,
            });
        }
        let prefix = layer_prefix(tower, sizes.layers - 1);
        let last = LastLayer {
            norm: loader.norm(&format!("{prefix}.layer_norm1"), sizes.eps)?,
            q: loader.linear(&prefix, &[q], sizes.width)?,
            kv: loader.linear(&prefix, &[k, v], sizes.width)?,
            out: loader.linear(&prefix, &[out], sizes.width)?,
            mlp: mlp(&prefix)?,
        };
        Ok(Self { layers, last, sizes, purpose: loader.purpose, precision: loader.precision })
    }

    /// From `state.x` (first entry) to `state.y`, the picked tokens of the last layer.
    pub(super) fn forward(&self, rec: &mut Recorder, state: &mut EncoderState) -> Result<(), KernelError> {
        let (ring, kept) = (state.x.len(), state.full.len());
        state.shared = self.layers.len().saturating_sub(1);
        for (i, layer) in self.layers.iter().enumerate() {
            let [x, next] = state
                .x
                .get_disjoint_mut([i % ring, (i + 1) % ring])
                .expect("the ring has at least two buffers whenever there is a full layer");
            layer.forward(rec, x, next, &mut state.full[i % kept], &mut state.scratch)?;
        }
        let x = &state.x[self.layers.len() % ring];
        self.last.forward(rec, x, &mut state.last, &mut state.scratch, &mut state.y)
    }

    /// From `v_y`, the gradient of `state.y`, to `state.v_x()`, the gradient of the first entry of `state.x`.
    pub(super) fn backward(
        &self,
        rec: &mut Recorder,
        v_y: &Buffer<f32>,
        state: &mut EncoderState,
    ) -> Result<(), KernelError> {
        let EncoderState { x, full, shared, last, scratch, grads, .. } = state;
        let is_shared = full.len() < self.layers.len();
        let grads = grads.as_mut().expect("workspaces with gradients are made from towers with adjoints only");
        let upstream = LastUpstream { x: &x[self.layers.len()], v_y };
        self.last.backward(rec, upstream, last, scratch, grads)?;
        for (i, layer) in self.layers.iter().enumerate().rev() {
            let state = &mut full[if is_shared { 0 } else { i }];
            if is_shared && *shared != i {
                layer.remember(rec, &x[i], state, scratch)?;
                *shared = i;
            }
            layer.backward(rec, &x[i], state, scratch, grads)?;
        }
        Ok(())
    }
}

/// What a full layer leaves for its backward pass.
#[derive(Debug)]
struct FullState {
    shape: AttentionShape,
    qkv: Buffer<f32>,
    attn: Buffer<f32>,
    stats: AttentionState,
    mlp: MlpState,
}

/// The same for the last layer; buffers are `[sequences, width]` unless they concern keys.
#[derive(Debug)]
struct LastState {
    batch: Batch,
    shape: AttentionShape,
    x: Buffer<f32>,
    hidden: Buffer<f32>,
    q: Buffer<f32>,
    kv: Buffer<f32>,
    attn: Buffer<f32>,
    stats: AttentionState,
    mlp: MlpState,
    scratch: MlpScratch,
}

/// Gradients of the buffer that layers hand on, and scratch.
#[derive(Debug)]
struct Grads {
    /// `[rows, width]`: gradient of a layer's output, then of its input.
    v_x: Buffer<f32>,
    /// `[rows, width]`: gradient between the halves of a layer.
    v_mid: Buffer<f32>,
    /// `[rows, width]`: gradient of the attention's output; in the last layer the picked rows' gradient of the norm.
    v_attn: Buffer<f32>,
    /// `[rows, 3*width]`
    v_qkv: Buffer<f32>,
    /// `[rows, 2*width]`: gradient of the last layer's keys and values.
    v_kv: Buffer<f32>,
    /// `[sequences, width]`, three of them for the last layer.
    picked: [Buffer<f32>; 3],
}

/// Activations of one batch.
#[derive(Debug)]
pub(super) struct EncoderState {
    /// Inputs of the layers; a ring of two when no gradient is wanted.
    pub(super) x: Vec<Buffer<f32>>,
    /// Picked tokens of the last layer `[sequences, width]`.
    pub(super) y: Buffer<f32>,
    /// One for each full layer, or one that all of them share.
    full: Vec<FullState>,
    /// Layer that a shared state is of.
    shared: usize,
    last: LastState,
    scratch: MlpScratch,
    grads: Option<Grads>,
}

impl EncoderState {
    /// Room for one batch.
    pub(super) fn new(device: &Device, name: &str, encoder: &Encoder, batch: Batch) -> Result<Self, KernelError> {
        let (sizes, purpose) = (&encoder.sizes, encoder.purpose);
        let full_layers = encoder.layers.len();
        let (ring, kept) = match purpose {
            TowerPurpose::Features => (2.min(full_layers + 1), 1.min(full_layers)),
            TowerPurpose::InputGradient => (full_layers + 1, full_layers),
            TowerPurpose::LeanInputGradient => (full_layers + 1, 1.min(full_layers)),
        };
        let wide = batch.rows() * sizes.width;
        let x = (0..ring).map(|i| device.buffer(&format!("{name}.{i}.x"), wide)).collect::<Result<_, _>>()?;
        let full = (0..kept).map(|i| FullState::new(device, &format!("{name}.{i}"), encoder, batch));
        Ok(Self {
            x,
            y: device.buffer(&format!("{name}.y"), batch.sequences * sizes.width)?,
            full: full.collect::<Result<_, _>>()?,
            shared: 0,
            last: LastState::new(device, &format!("{name}.last"), encoder, batch)?,
            scratch: MlpScratch::new(device, name, batch.rows(), sizes.width, sizes.inner)?,
            grads: if purpose.has_gradient() { Some(Grads::new(device, name, sizes.width, batch)?) } else { None },
        })
    }

    /// Whether the backward pass computes activations again. There is one input more than full layers when gradients
    /// are asked for.
    pub(super) fn recomputes(&self) -> bool {
        self.grads.is_some() && self.full.len() + 1 < self.x.len()
    }

    /// Gives back the memory of activations that the backward pass can compute again; whether there were any.
    pub(super) fn forget_activations(&mut self) -> bool {
        let had = self.full.len() > 1;
        if had {
            (self.full, self.shared) = (self.full.drain(..1).collect(), 0);
        }
        had
    }

    /// Gradient of the first entry of `x` after the backward pass.
    pub(super) fn v_x(&self) -> &Buffer<f32> {
        &self.grads.as_ref().expect("workspaces with gradients are made from towers with adjoints only").v_x
    }
}

fn attention_shape(encoder: &Encoder, batch: Batch) -> AttentionShape {
    let sizes = &encoder.sizes;
    AttentionShape {
        batch: batch.sequences,
        heads: sizes.heads,
        head_dim: sizes.width / sizes.heads,
        queries: batch.tokens,
        keys: batch.tokens,
        mask: batch.mask,
        precision: encoder.precision,
    }
}

impl FullState {
    fn new(device: &Device, name: &str, encoder: &Encoder, batch: Batch) -> Result<Self, KernelError> {
        let sizes = &encoder.sizes;
        let shape = attention_shape(encoder, batch);
        let wide = batch.rows() * sizes.width;
        Ok(Self {
            shape,
            qkv: device.buffer(&format!("{name}.qkv"), 3 * wide)?,
            attn: device.buffer(&format!("{name}.attn"), wide)?,
            stats: AttentionState::new(device, name, &shape)?,
            mlp: MlpState::new(device, name, batch.rows(), sizes.width, sizes.inner, encoder.purpose)?,
        })
    }
}

impl LastState {
    fn new(device: &Device, name: &str, encoder: &Encoder, batch: Batch) -> Result<Self, KernelError> {
        let sizes = &encoder.sizes;
        // The causal mask lets the last token see every key, which is what one query at the end of the keys sees.
        let shape = AttentionShape { queries: 1, mask: Mask::Full, ..attention_shape(encoder, batch) };
        let narrow = batch.sequences * sizes.width;
        Ok(Self {
            batch,
            shape,
            x: device.buffer(&format!("{name}.x"), narrow)?,
            hidden: device.buffer(&format!("{name}.hidden"), narrow)?,
            q: device.buffer(&format!("{name}.q"), narrow)?,
            kv: device.buffer(&format!("{name}.kv"), 2 * batch.rows() * sizes.width)?,
            attn: device.buffer(&format!("{name}.attn"), narrow)?,
            stats: AttentionState::new(device, name, &shape)?,
            mlp: MlpState::new(device, name, batch.sequences, sizes.width, sizes.inner, encoder.purpose)?,
            scratch: MlpScratch::new(device, name, batch.sequences, sizes.width, sizes.inner)?,
        })
    }
}

impl Grads {
    fn new(device: &Device, name: &str, width: usize, batch: Batch) -> Result<Self, KernelError> {
        let wide = batch.rows() * width;
        let picked = |i: usize| device.buffer(&format!("{name}.v_picked{i}"), batch.sequences * width);
        Ok(Self {
            v_x: device.buffer(&format!("{name}.v_x"), wide)?,
            v_mid: device.buffer(&format!("{name}.v_mid"), wide)?,
            v_attn: device.buffer(&format!("{name}.v_attn"), wide)?,
            v_qkv: device.buffer(&format!("{name}.v_qkv"), 3 * wide)?,
            v_kv: device.buffer(&format!("{name}.v_kv"), 2 * wide)?,
            picked: [picked(0)?, picked(1)?, picked(2)?],
        })
    }
}

impl FullLayer {
    fn forward(
        &self,
        rec: &mut Recorder,
        x: &Buffer<f32>,
        next: &mut Buffer<f32>,
        state: &mut FullState,
        scratch: &mut MlpScratch,
    ) -> Result<(), KernelError> {
        self.attend(rec, x, state, scratch)?;
        self.mlp.forward(rec, &mut state.mlp, scratch, next)
    }

    /// What of the forward pass the backward one reads.
    fn remember(
        &self,
        rec: &mut Recorder,
        x: &Buffer<f32>,
        state: &mut FullState,
        scratch: &mut MlpScratch,
    ) -> Result<(), KernelError> {
        self.attend(rec, x, state, scratch)?;
        self.mlp.before_activation(rec, &mut state.mlp, scratch)
    }

    /// First half of the layer, to `state.mlp.x`.
    fn attend(
        &self,
        rec: &mut Recorder,
        x: &Buffer<f32>,
        state: &mut FullState,
        scratch: &mut MlpScratch,
    ) -> Result<(), KernelError> {
        let rows = Rows::all(x.len() / self.norm.width());
        layer_norm::forward(rec, &self.norm, x, rows, &mut scratch.hidden)?;
        self.qkv.forward(rec, &scratch.hidden, PLAIN, &mut state.qkv)?;
        let inputs = Projections::Fused(&state.qkv);
        attention::forward(rec, &state.shape, inputs, &mut state.stats, &mut state.attn)?;
        self.out.forward(rec, &state.attn, Epilogue::Add(x), &mut state.mlp.x)
    }

    /// `grads.v_x` is the gradient of the output before, of the input after.
    fn backward(
        &self,
        rec: &mut Recorder,
        x: &Buffer<f32>,
        state: &mut FullState,
        scratch: &mut MlpScratch,
        grads: &mut Grads,
    ) -> Result<(), KernelError> {
        let rows = Rows::all(x.len() / self.norm.width());
        self.mlp.backward(rec, &state.mlp, &grads.v_x, scratch, &mut grads.v_mid)?;
        self.out.backward(rec, &grads.v_mid, PLAIN, &mut grads.v_attn)?;
        let inputs = Projections::Fused(&state.qkv);
        let upstream = Upstream { inputs, attn: &state.attn, v_attn: &grads.v_attn };
        let out = ProjectionGrads::Fused(&mut grads.v_qkv);
        attention::backward(rec, &state.shape, &upstream, &mut state.stats, out)?;
        self.qkv.backward(rec, &grads.v_qkv, PLAIN, &mut scratch.hidden)?;
        let upstream = layer_norm::Upstream { x, v_y: &scratch.hidden, v_residual: Some(&grads.v_mid) };
        layer_norm::backward(rec, &self.norm, &upstream, rows, &mut grads.v_x)
    }
}

/// What the last layer's backward pass starts from.
#[derive(Clone, Copy)]
struct LastUpstream<'a> {
    /// All inputs of the layer `[rows, width]`.
    x: &'a Buffer<f32>,
    /// Gradient of the picked outputs `[sequences, width]`.
    v_y: &'a Buffer<f32>,
}

impl LastLayer {
    fn forward(
        &self,
        rec: &mut Recorder,
        x: &Buffer<f32>,
        state: &mut LastState,
        scratch: &mut MlpScratch,
        y: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        let batch = state.batch;
        layer_norm::forward(rec, &self.norm, x, Rows::all(batch.rows()), &mut scratch.hidden)?;
        self.kv.forward(rec, &scratch.hidden, PLAIN, &mut state.kv)?;
        gather(rec, x, batch.picked(), &mut state.x)?;
        gather(rec, &scratch.hidden, batch.picked(), &mut state.hidden)?;
        self.q.forward(rec, &state.hidden, PLAIN, &mut state.q)?;
        let inputs = Projections::Split { q: &state.q, kv: &state.kv };
        attention::forward(rec, &state.shape, inputs, &mut state.stats, &mut state.attn)?;
        self.out.forward(rec, &state.attn, Epilogue::Add(&state.x), &mut state.mlp.x)?;
        self.mlp.forward(rec, &mut state.mlp, &mut state.scratch, y)
    }

    /// From the gradient of the picked outputs to `grads.v_x`, the gradient of all inputs.
    fn backward(
        &self,
        rec: &mut Recorder,
        upstream: LastUpstream<'_>,
        state: &mut LastState,
        scratch: &mut MlpScratch,
        grads: &mut Grads,
    ) -> Result<(), KernelError> {
        let LastUpstream { x, v_y } = upstream;
        let batch = state.batch;
        let [v_mid, v_attn, v_q] = &mut grads.picked;
        self.mlp.backward(rec, &state.mlp, v_y, &mut state.scratch, v_mid)?;
        self.out.backward(rec, v_mid, PLAIN, v_attn)?;
        let inputs = Projections::Split { q: &state.q, kv: &state.kv };
        let upstream = Upstream { inputs, attn: &state.attn, v_attn };
        let out = ProjectionGrads::Split { v_q, v_kv: &mut grads.v_kv };
        attention::backward(rec, &state.shape, &upstream, &mut state.stats, out)?;
        self.q.backward(rec, v_q, PLAIN, &mut state.hidden)?;
        // Both gradients of picked rows become rows of zeros elsewhere, and are added where all rows are written.
        scatter(rec, &state.hidden, batch.picked(), &mut grads.v_attn)?;
        scatter(rec, v_mid, batch.picked(), &mut grads.v_mid)?;
        self.kv.backward(rec, &grads.v_kv, Epilogue::Add(&grads.v_attn), &mut scratch.hidden)?;
        let upstream = layer_norm::Upstream { x, v_y: &scratch.hidden, v_residual: Some(&grads.v_mid) };
        layer_norm::backward(rec, &self.norm, &upstream, Rows::all(batch.rows()), &mut grads.v_x)
    }
}

/// Copies the selected rows of `from` into the rows of `to`.
fn gather(rec: &mut Recorder, from: &Buffer<f32>, rows: Rows, to: &mut Buffer<f32>) -> Result<(), KernelError> {
    let width = to.len() / rows.count.max(1);
    (0..rows.count).try_for_each(|i| rec.copy(from, (rows.offset + i * rows.step) * width, to, i * width, width))
}

/// Copies the rows of `from` into the selected rows of `to`; the other rows become zero.
fn scatter(rec: &mut Recorder, from: &Buffer<f32>, rows: Rows, to: &mut Buffer<f32>) -> Result<(), KernelError> {
    let width = from.len() / rows.count.max(1);
    rec.fill(to, 0.0);
    (0..rows.count).try_for_each(|i| rec.copy(from, i * width, to, (rows.offset + i * rows.step) * width, width))
}
