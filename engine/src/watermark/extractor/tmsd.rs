//! TMSD: the residual 3D ConvNet in front of CLIP (Guard4D Sec. 3.4, Eq. 7).

use clap::Args;
use guard4d_kernels::image::colour_map::{self, ColourMap};
use guard4d_kernels::nn::axpy;
use guard4d_kernels::nn::conv3d::{
    self, Activation, Bias, Conv3d, Conv3dScratch, InputGradient, Padding, WeightGradient,
};
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState};
use guard4d_kernels::shape::{Accumulate, ClipShape};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};
use rand_chacha::ChaCha20Rng;
use serde::{Deserialize, Serialize};

use crate::base::prf::uniform_unit;
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;

/// Colour channels, and the four that a texel holds.
const RGB: usize = 3;
const TEXEL: usize = 4;
const TAPS: usize = 27;

/// A colour map that changes nothing.
pub const SAME_COLOURS: ColourMap = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Size of the network. The paper says only "shallow"; three layers of 3×3×3 are the usual reading.
///
/// There is no switch for biases. What the network adds to a clip must come from the clip: with biases it could print
/// the message where the colour map leaves nothing of an unmarked clip, and a match would say nothing about the scene.
#[derive(Args, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TmsdConfig {
    /// Convolutions, at least two; 0 leaves the colour map alone
    #[arg(long = "tmsd-depth", value_name = "N", hide = true)]
    pub depth: usize,
    /// Hidden channels, a multiple of four
    #[arg(long = "tmsd-width", value_name = "N", hide = true)]
    pub width: usize,
    /// Residual scale s of Eq. 7
    #[arg(long = "tmsd-scale", value_name = "FACTOR", hide = true)]
    pub scale: f32,
}

impl Default for TmsdConfig {
    fn default() -> Self {
        Self { depth: 3, width: 16, scale: 1.0 }
    }
}

impl TmsdConfig {
    /// No network behind the colour map.
    #[must_use]
    pub fn colour_map_only() -> Self {
        Self { depth: 0, ..Self::default() }
    }

    /// Input and output channels of each layer, before padding to texels.
    fn channels(&self) -> Vec<(usize, usize)> {
        let inner = |i: usize| if i == 0 { RGB } else { self.width };
        let outer = |i: usize| if i + 1 == self.depth { RGB } else { self.width };
        (0..self.depth).map(|i| (inner(i), outer(i))).collect()
    }

    /// Refuses sizes that the network cannot have.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the field.
    pub fn validate(&self) -> Result<(), EngineError> {
        let usage = |what: &str, got: String, expected: &str| EngineError::Usage {
            what: what.to_owned(),
            got,
            expected: expected.to_owned(),
        };
        if self.depth != 0 && !(2..=8).contains(&self.depth) {
            return Err(usage("TMSD depth", self.depth.to_string(), "0 or 2 to 8 convolutions"));
        }
        if self.width == 0 || !self.width.is_multiple_of(TEXEL) || self.width > 64 {
            return Err(usage("TMSD width", self.width.to_string(), "a multiple of 4 from 4 to 64"));
        }
        if !(self.scale.is_finite() && self.scale > 0.0) {
            return Err(usage("TMSD scale", self.scale.to_string(), "a positive number"));
        }
        Ok(())
    }
}

/// Weights `[Co, Ci, 3, 3, 3]` of each layer, as PyTorch stores them; bias-free, so that a black clip stays black.
#[derive(Clone, Debug, PartialEq)]
pub struct TmsdWeights {
    /// Size of the network.
    pub config: TmsdConfig,
    /// Colour map M in front of the network, frozen.
    pub colour_map: ColourMap,
    /// One tensor per layer.
    pub layers: Vec<Vec<f32>>,
}

impl TmsdWeights {
    /// PyTorch's default initialisation with a zero last layer: R(x) = M x.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, reason = "weights are single precision")]
    pub fn new(config: TmsdConfig, colour_map: ColourMap, rng: &mut ChaCha20Rng) -> Self {
        let layer = |(i, (inputs, outputs)): (usize, (usize, usize))| {
            let bound = if i + 1 == config.depth { 0.0 } else { 1.0 / ((inputs * TAPS) as f64).sqrt() };
            (0..inputs * outputs * TAPS).map(|_| ((2.0 * uniform_unit(rng) - 1.0) * bound) as f32).collect()
        };
        Self { config, colour_map, layers: config.channels().into_iter().enumerate().map(layer).collect() }
    }

    /// The same network behind another colour map.
    #[must_use]
    pub fn with_colour_map(&self, colour_map: ColourMap) -> Self {
        Self { colour_map, ..self.clone() }
    }

    /// Whether the network does anything: one that was never trained has a last layer of zeros, and leaves R(x) = M x.
    #[must_use]
    pub fn is_trained(&self) -> bool {
        self.layers.last().is_some_and(|layer| layer.iter().any(|w| *w != 0.0))
    }

    /// Adds the tensors `tmsd.{i}.weight` and the sizes to a file.
    pub fn store(&self, file: &mut TensorFile) {
        let config = serde_json::to_string(&self.config).expect("numbers are valid JSON");
        file.meta.insert("tmsd".to_owned(), config);
        let map = Tensor::f32(&[RGB, RGB], self.colour_map.as_flattened().to_vec());
        file.tensors.insert("tmsd.colour_map".to_owned(), map);
        for (i, ((inputs, outputs), layer)) in self.config.channels().into_iter().zip(&self.layers).enumerate() {
            let shape = [outputs, inputs, 3, 3, 3];
            file.tensors.insert(format!("tmsd.{i}.weight"), Tensor::f32(&shape, layer.clone()));
        }
    }

    /// Reads what [`TmsdWeights::store`] wrote; `None` when the file holds no network.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the entry or tensor.
    pub fn load(file: &TensorFile) -> Result<Option<Self>, EngineError> {
        let Some(text) = file.meta.get("tmsd") else { return Ok(None) };
        let config: TmsdConfig = serde_json::from_str(text).map_err(|e| EngineError::BadData {
            path: file.path.clone(),
            field: "metadata `tmsd`".to_owned(),
            got: e.to_string(),
            expected: "depth, width and scale".to_owned(),
        })?;
        config.validate()?;
        let layers = config.channels().into_iter().enumerate().map(|(i, (inputs, outputs))| {
            Ok(file.finite(&format!("tmsd.{i}.weight"), &[outputs, inputs, 3, 3, 3])?.to_vec())
        });
        let map = file.finite("tmsd.colour_map", &[RGB, RGB])?;
        let colour_map = std::array::from_fn(|i| std::array::from_fn(|j| map[i * RGB + j]));
        Ok(Some(Self { config, colour_map, layers: layers.collect::<Result<_, EngineError>>()? }))
    }
}

#[derive(Debug)]
struct Layer {
    conv: Conv3d,
    weight: Buffer<f32>,
    v_weight: Buffer<f32>,
    scratch: Conv3dScratch,
    state: AdamState,
    /// Channels before padding.
    given: (usize, usize),
}

/// R on the device, for clips of one shape.
#[derive(Debug)]
pub struct Tmsd {
    config: TmsdConfig,
    colour_map: ColourMap,
    shape: ClipShape,
    layers: Vec<Layer>,
}

/// Activations and gradients of one clip.
#[derive(Debug)]
pub struct TmsdPass {
    /// Input of each layer; the first is y.
    inputs: Vec<Buffer<f32>>,
    delta: Buffer<f32>,
    /// R(x) `[F,S,S,4]`
    pub out: Buffer<f32>,
    v_inputs: Vec<Buffer<f32>>,
    v_delta: Buffer<f32>,
    /// dL/dR(x) `[F,S,S,4]`, written by whoever comes after.
    pub v_out: Buffer<f32>,
    /// dL/dx `[F,S,S,4]`
    pub v_x: Buffer<f32>,
}

impl Tmsd {
    /// Uploads weights for clips of `shape`; `precision` is that of the convolutions, see [`Conv3d::precision`].
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(
        device: &Device,
        weights: &TmsdWeights,
        shape: ClipShape,
        precision: Precision,
    ) -> Result<Self, KernelError> {
        let layers = weights.config.channels().into_iter().zip(&weights.layers).enumerate().map(|(i, (given, w))| {
            let conv = Conv3d {
                shape,
                in_channels: given.0.next_multiple_of(TEXEL),
                out_channels: given.1.next_multiple_of(TEXEL),
                time: Padding::Replicate,
                space: Padding::Reflect,
                bias: Bias::None,
                activation: if i + 1 == weights.config.depth { Activation::Identity } else { Activation::Relu },
                precision,
            };
            let packed = conv.pack(w, given.0, given.1);
            let n = packed.len();
            Ok(Layer {
                weight: device.buffer_from(&format!("tmsd.{i}.weight"), &packed)?,
                v_weight: device.buffer(&format!("tmsd.{i}.v_weight"), n)?,
                scratch: Conv3dScratch::new(device, &conv)?,
                state: AdamState::new(device, &format!("tmsd.{i}"), n)?,
                conv,
                given,
            })
        });
        Ok(Self {
            config: weights.config,
            colour_map: weights.colour_map,
            shape,
            layers: layers.collect::<Result<_, KernelError>>()?,
        })
    }

    /// Puts another colour map in front of the network.
    pub fn set_colour_map(&mut self, colour_map: ColourMap) {
        self.colour_map = colour_map;
    }

    /// Buffers for one clip.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn pass(&self, device: &Device) -> Result<TmsdPass, KernelError> {
        let clip = |name: &str, channels: usize| device.buffer(&format!("tmsd.{name}"), self.shape.pixels() * channels);
        let per_layer = |name: &str| {
            self.layers.iter().map(|l| clip(name, l.conv.in_channels)).collect::<Result<Vec<_>, KernelError>>()
        };
        Ok(TmsdPass {
            inputs: per_layer("input")?,
            delta: clip("delta", TEXEL)?,
            out: clip("out", TEXEL)?,
            v_inputs: per_layer("v_input")?,
            v_delta: clip("v_delta", TEXEL)?,
            v_out: clip("v_out", TEXEL)?,
            v_x: clip("v_x", TEXEL)?,
        })
    }

    /// `pass.out` = y + s·Δ(y) with y = M x.
    ///
    /// # Shapes
    /// in `x` \[F,S,S,4\], fourth channel 0 · out `pass.out` \[F,S,S,4\] (=)
    /// # Equation: Guard4D Eq. 7
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn forward(&self, rec: &mut Recorder, x: &Buffer<f32>, pass: &mut TmsdPass) -> Result<(), KernelError> {
        let Some(first) = pass.inputs.first_mut() else {
            return colour_map::forward(rec, &self.colour_map, x, &mut pass.out);
        };
        colour_map::forward(rec, &self.colour_map, x, first)?;
        for (i, layer) in self.layers.iter().enumerate() {
            let (done, rest) = pass.inputs.split_at_mut(i + 1);
            let out = rest.first_mut().unwrap_or(&mut pass.delta);
            conv3d::forward(rec, &layer.conv, &done[i], &layer.weight, out)?;
        }
        axpy::forward(rec, self.config.scale, &pass.inputs[0], &pass.delta, &mut pass.out)
    }

    /// `pass.v_x` from `pass.v_out`; with `weights` also the gradients of the weights, replaced or added to.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn backward(
        &mut self,
        rec: &mut Recorder,
        pass: &mut TmsdPass,
        weights: Option<Accumulate>,
    ) -> Result<(), KernelError> {
        if self.layers.is_empty() {
            return colour_map::backward(rec, &self.colour_map, &pass.v_out, &mut pass.v_x);
        }
        axpy::backward(rec, self.config.scale, &pass.v_out, &mut pass.v_delta)?;
        for i in (0..self.layers.len()).rev() {
            let Layer { conv, weight, v_weight, scratch, .. } = &mut self.layers[i];
            let (below, above) = pass.v_inputs.split_at_mut(i + 1);
            let v_y = above.first().unwrap_or(&pass.v_delta);
            if let Some(accumulate) = weights {
                let gradient = WeightGradient { x: &pass.inputs[i], v_y, v_weight, accumulate };
                conv3d::backward_weight(rec, conv, gradient, scratch)?;
            }
            let gate = (i > 0).then_some(&pass.inputs[i]);
            conv3d::backward_input(rec, conv, InputGradient { v_y, weight, gate }, &mut below[i], scratch)?;
        }
        axpy::forward(rec, 1.0, &pass.v_out, &pass.v_inputs[0], &mut pass.v_delta)?;
        colour_map::backward(rec, &self.colour_map, &pass.v_delta, &mut pass.v_x)
    }

    /// One Adam step on all weights.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn step(&mut self, rec: &mut Recorder, config: &AdamConfig) -> Result<(), KernelError> {
        for layer in &mut self.layers {
            adam::step(rec, &mut layer.weight, &layer.v_weight, &mut layer.state, config)?;
        }
        Ok(())
    }

    /// The weights as they are now.
    ///
    /// # Errors
    /// When reading from the device fails.
    pub fn weights(&self) -> Result<TmsdWeights, KernelError> {
        let read = |l: &Layer| Ok(l.conv.unpack(&l.weight.read()?, l.given.0, l.given.1));
        Ok(TmsdWeights {
            config: self.config,
            colour_map: self.colour_map,
            layers: self.layers.iter().map(read).collect::<Result<_, KernelError>>()?,
        })
    }

    /// Gradients of the weights as [`Tmsd::backward`] left them, shaped like [`TmsdWeights::layers`].
    ///
    /// # Errors
    /// When reading from the device fails.
    pub fn weight_gradients(&self) -> Result<Vec<Vec<f32>>, KernelError> {
        self.layers.iter().map(|l| Ok(l.conv.unpack(&l.v_weight.read()?, l.given.0, l.given.1))).collect()
    }

    /// Weights' optimiser moments by tensor name, for checkpoints.
    pub fn states(&mut self) -> impl Iterator<Item = (String, &mut Buffer<f32>, &mut AdamState)> {
        self.layers.iter_mut().enumerate().map(|(i, l)| (format!("tmsd.{i}"), &mut l.weight, &mut l.state))
    }
}
