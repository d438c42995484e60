//! Message decoder: an MLP from CLIP features to one logit per bit.

use guard4d_kernels::nn::activation::{self, Activation};
use guard4d_kernels::nn::matmul::{self, Epilogue, Product};
use guard4d_kernels::nn::pack::{PackedWeight, Precision};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;

/// Width of the two hidden layers (GuardSplat's decoder: 512 → 256 → 256 → L).
pub const HIDDEN: usize = 256;
/// Linear layers.
pub const LAYERS: usize = 3;

/// Weights of one linear layer, as PyTorch stores them.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// `[outputs, inputs]`
    pub weight: Vec<f32>,
    /// `[outputs]`
    pub bias: Vec<f32>,
    /// Rows of the weight.
    pub outputs: usize,
    /// Columns of the weight.
    pub inputs: usize,
}

/// Weights of the whole decoder on the host.
#[derive(Clone, Debug, PartialEq)]
pub struct DecoderWeights {
    /// Linear layers in order.
    pub layers: [Linear; LAYERS],
}

impl DecoderWeights {
    /// Inputs and outputs of each layer for features of `width` and `bits` bits.
    #[must_use]
    pub fn sizes(width: usize, bits: usize) -> [(usize, usize); LAYERS] {
        [(width, HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, bits)]
    }

    /// Weights that make a logit of 0 of everything.
    #[must_use]
    pub fn zeros(width: usize, bits: usize) -> Self {
        let layers = Self::sizes(width, bits).map(|(inputs, outputs)| Linear {
            weight: vec![0.0; inputs * outputs],
            bias: vec![0.0; outputs],
            outputs,
            inputs,
        });
        Self { layers }
    }

    /// Message bits.
    #[must_use]
    pub fn bits(&self) -> usize {
        self.layers[LAYERS - 1].outputs
    }

    /// Feature width.
    #[must_use]
    pub fn width(&self) -> usize {
        self.layers[0].inputs
    }

    /// Adds the tensors `decoder.{i}.weight` and `.bias` to a key file.
    pub fn store(&self, file: &mut TensorFile) {
        for (i, layer) in self.layers.iter().enumerate() {
            let shape = [layer.outputs, layer.inputs];
            file.tensors.insert(format!("decoder.{i}.weight"), Tensor::f32(&shape, layer.weight.clone()));
            file.tensors.insert(format!("decoder.{i}.bias"), Tensor::f32(&[layer.outputs], layer.bias.clone()));
        }
    }

    /// Reads the tensors that [`DecoderWeights::store`] wrote.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the tensor that is missing or has another shape.
    pub fn load(file: &TensorFile, width: usize, bits: usize) -> Result<Self, EngineError> {
        let mut layers = Vec::with_capacity(LAYERS);
        for (i, (inputs, outputs)) in Self::sizes(width, bits).into_iter().enumerate() {
            let weight = file.finite(&format!("decoder.{i}.weight"), &[outputs, inputs])?.to_vec();
            let bias = file.finite(&format!("decoder.{i}.bias"), &[outputs])?.to_vec();
            layers.push(Linear { weight, bias, outputs, inputs });
        }
        let layers = layers.try_into().expect("one layer was pushed per size");
        Ok(Self { layers })
    }
}

#[derive(Debug)]
struct FrozenLinear {
    weight: PackedWeight,
    weight_t: PackedWeight,
    bias: Buffer<f32>,
}

impl FrozenLinear {
    fn product<'a>(&'a self, input: &'a Buffer<f32>, rows: usize) -> Product<'a> {
        Product { bias: Some(&self.bias), ..Product::plain(input, rows, &self.weight) }
    }
}

/// The frozen decoder on the device.
#[derive(Debug)]
pub struct Decoder {
    layers: [FrozenLinear; LAYERS],
    width: usize,
    bits: usize,
}

/// Activations and gradients of one batch.
#[derive(Debug)]
pub struct DecoderPass {
    rows: usize,
    pre: [Buffer<f32>; LAYERS - 1],
    hidden: [Buffer<f32>; LAYERS - 1],
    v_pre: [Buffer<f32>; LAYERS - 1],
    /// `[rows, bits]`
    pub logits: Buffer<f32>,
    /// dL/d(logits) `[rows, bits]`; written by the loss.
    pub v_logits: Buffer<f32>,
    /// dL/d(features) `[rows, width]`
    pub v_features: Buffer<f32>,
}

impl Decoder {
    /// Uploads frozen weights. `bits` and `width` must be multiples of 8.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, weights: &DecoderWeights) -> Result<Self, KernelError> {
        let upload = |i: usize| -> Result<FrozenLinear, KernelError> {
            let Linear { weight, bias, outputs, inputs } = &weights.layers[i];
            Ok(FrozenLinear {
                weight: PackedWeight::new(device, &format!("decoder.{i}.weight"), weight, *outputs, *inputs)?,
                weight_t: PackedWeight::transposed(
                    device,
                    &format!("decoder.{i}.weight_t"),
                    weight,
                    *inputs,
                    *outputs,
                    Precision::F32,
                )?,
                bias: device.buffer_from(&format!("decoder.{i}.bias"), bias)?,
            })
        };
        Ok(Self { layers: [upload(0)?, upload(1)?, upload(2)?], width: weights.width(), bits: weights.bits() })
    }

    /// Buffers for batches of `rows` features.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn pass(&self, device: &Device, rows: usize) -> Result<DecoderPass, KernelError> {
        let hidden = |name: &str| device.buffer(&format!("decoder.{name}"), rows * HIDDEN);
        Ok(DecoderPass {
            rows,
            pre: [hidden("pre.0")?, hidden("pre.1")?],
            hidden: [hidden("hidden.0")?, hidden("hidden.1")?],
            v_pre: [hidden("v_pre.0")?, hidden("v_pre.1")?],
            logits: device.buffer("decoder.logits", rows * self.bits)?,
            v_logits: device.buffer("decoder.v_logits", rows * self.bits)?,
            v_features: device.buffer("decoder.v_features", rows * self.width)?,
        })
    }

    /// Logits of a batch: `pass.logits` from `features` `[rows, width]`.
    ///
    /// # Equation: Guard4D Eq. 4; GELU between the layers
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn forward(
        &self,
        rec: &mut Recorder,
        features: &Buffer<f32>,
        pass: &mut DecoderPass,
    ) -> Result<(), KernelError> {
        let rows = pass.rows;
        let [first, second, third] = &self.layers;
        matmul::forward(rec, &first.product(features, rows), &mut pass.pre[0])?;
        activation::forward(rec, Activation::Gelu, &pass.pre[0], &mut pass.hidden[0])?;
        matmul::forward(rec, &second.product(&pass.hidden[0], rows), &mut pass.pre[1])?;
        activation::forward(rec, Activation::Gelu, &pass.pre[1], &mut pass.hidden[1])?;
        matmul::forward(rec, &third.product(&pass.hidden[1], rows), &mut pass.logits)
    }

    /// Gradient to the features from `pass.v_logits`, into `pass.v_features`.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn backward(&self, rec: &mut Recorder, pass: &mut DecoderPass) -> Result<(), KernelError> {
        let rows = pass.rows;
        let [v_pre0, v_pre1] = &mut pass.v_pre;
        let [first, second, third] = &self.layers;
        let epilogue = Epilogue::Grad(Activation::Gelu, &pass.pre[1]);
        let product = Product { epilogue, ..Product::plain(&pass.v_logits, rows, &third.weight_t) };
        matmul::forward(rec, &product, v_pre1)?;
        let epilogue = Epilogue::Grad(Activation::Gelu, &pass.pre[0]);
        let product = Product { epilogue, ..Product::plain(v_pre1, rows, &second.weight_t) };
        matmul::forward(rec, &product, v_pre0)?;
        matmul::forward(rec, &Product::plain(v_pre0, rows, &first.weight_t), &mut pass.v_features)
    }
}
