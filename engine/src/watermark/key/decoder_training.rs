//! Training of the message decoder on CLIP text features (Guard4D Sec. 3.2, Eq. 4–5).

use guard4d_kernels::loss::bce::{self, Answers, Groups, Objective};
use guard4d_kernels::nn::activation::{self, Activation};
use guard4d_kernels::nn::column_sum;
use guard4d_kernels::nn::matmul::{self, Epilogue, GradScratch, Product};
use guard4d_kernels::nn::pack::{self, Order, PackedWeight};
use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};
use rand_chacha::ChaCha20Rng;

use super::decoder::{DecoderWeights, HIDDEN, LAYERS, Linear};
use crate::base::prf::uniform_unit;
use crate::base::schedule::cosine;

/// How the decoder is trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DecoderTraining {
    /// Messages per step.
    pub batch: usize,
    /// Passes over the training messages.
    pub epochs: usize,
    /// Adam's rate at the start; it falls to zero along a half cosine.
    pub lr: f32,
}

impl DecoderTraining {
    /// Longer messages take more passes and larger steps: their bits move the text feature less.
    ///
    /// At 2e-3 up to 18 of the 196,608 held-out bits of 48-bit keys were misread, where 19 may be; at 4e-3 at most 3.
    pub(super) fn for_bits(bits: usize) -> Self {
        let (epochs, lr) = match bits {
            0..=16 => (12, 1e-3),
            17..=32 => (40, 2e-3),
            _ => (40, 4e-3),
        };
        Self { batch: 256, epochs, lr }
    }
}

struct TrainedLinear {
    weight: Buffer<f32>,
    bias: Buffer<f32>,
    packed: PackedWeight,
    packed_t: PackedWeight,
    v_weight: Buffer<f32>,
    v_bias: Buffer<f32>,
    scratch: GradScratch,
    weight_state: AdamState,
    bias_state: AdamState,
    inputs: usize,
    outputs: usize,
}

/// A decoder in training.
pub(super) struct Trainer {
    layers: [TrainedLinear; LAYERS],
    config: DecoderTraining,
    features: Buffer<f32>,
    targets: Buffer<f32>,
    pre: [Buffer<f32>; LAYERS - 1],
    hidden: [Buffer<f32>; LAYERS - 1],
    v_pre: [Buffer<f32>; LAYERS - 1],
    logits: Buffer<f32>,
    v_logits: Buffer<f32>,
    value: Buffer<f32>,
}

impl Trainer {
    /// A decoder with PyTorch's default initialisation, drawn from `init`.
    pub(super) fn new(
        device: &Device,
        width: usize,
        bits: usize,
        config: DecoderTraining,
        init: &mut ChaCha20Rng,
    ) -> Result<Self, KernelError> {
        let rows = config.batch;
        let sizes = DecoderWeights::sizes(width, bits);
        let mut layer = |i: usize| {
            let (inputs, outputs) = sizes[i];
            TrainedLinear::new(device, i, inputs, outputs, rows, init)
        };
        let hidden = |name: &str| device.buffer(&format!("trainer.{name}"), rows * HIDDEN);
        Ok(Self {
            layers: [layer(0)?, layer(1)?, layer(2)?],
            config,
            features: device.buffer("trainer.features", rows * width)?,
            targets: device.buffer("trainer.targets", rows * bits)?,
            pre: [hidden("pre.0")?, hidden("pre.1")?],
            hidden: [hidden("hidden.0")?, hidden("hidden.1")?],
            v_pre: [hidden("v_pre.0")?, hidden("v_pre.1")?],
            logits: device.buffer("trainer.logits", rows * bits)?,
            v_logits: device.buffer("trainer.v_logits", rows * bits)?,
            value: device.buffer("trainer.value", 1)?,
        })
    }

    /// Trains on `features` `[n, width]` with the bits of their messages `[n, bits]` (0 or 1).
    ///
    /// Rows are visited in a fixed order: the messages are independent draws, so their order carries
    /// nothing that shuffling would remove.
    pub(super) fn run(
        &mut self,
        device: &Device,
        features: &Buffer<f32>,
        bits: &Buffer<f32>,
    ) -> Result<(), KernelError> {
        let rows = self.config.batch;
        let width = self.features.len() / rows;
        let num_bits = self.targets.len() / rows;
        let steps_per_epoch = features.len() / width / rows;
        let steps = steps_per_epoch * self.config.epochs;
        for step in 0..steps {
            let start = step % steps_per_epoch * rows;
            let mut rec = device.recorder()?;
            rec.copy(features, start * width, &mut self.features, 0, rows * width)?;
            rec.copy(bits, start * num_bits, &mut self.targets, 0, rows * num_bits)?;
            let lr = self.config.lr * cosine(step, steps, 0.0);
            self.step(&mut rec, &AdamConfig { lr, ..AdamConfig::default() })?;
            rec.submit()?;
        }
        Ok(())
    }

    /// The weights as they are now.
    pub(super) fn weights(&self) -> Result<DecoderWeights, KernelError> {
        let read = |layer: &TrainedLinear| -> Result<Linear, KernelError> {
            let TrainedLinear { weight, bias, inputs, outputs, .. } = layer;
            Ok(Linear { weight: weight.read()?, bias: bias.read()?, inputs: *inputs, outputs: *outputs })
        };
        Ok(DecoderWeights { layers: [read(&self.layers[0])?, read(&self.layers[1])?, read(&self.layers[2])?] })
    }

    fn step(&mut self, rec: &mut Recorder, adam: &AdamConfig) -> Result<(), KernelError> {
        for layer in &mut self.layers {
            layer.pack(rec)?;
        }
        self.forward(rec)?;
        let groups = Groups { groups: 1, rows: self.config.batch, bits: self.targets.len() / self.config.batch };
        let answers = Answers { groups, logits: &self.logits, target: &self.targets };
        bce::forward(rec, Objective::Bce, &answers, &mut self.value)?;
        bce::backward(rec, Objective::Bce, 1.0, &answers, &self.value, &mut self.v_logits)?;
        self.backward(rec)?;
        for layer in &mut self.layers {
            adam::step(rec, &mut layer.weight, &layer.v_weight, &mut layer.weight_state, adam)?;
            adam::step(rec, &mut layer.bias, &layer.v_bias, &mut layer.bias_state, adam)?;
        }
        Ok(())
    }

    fn forward(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        let rows = self.config.batch;
        let [first, second, third] = &self.layers;
        matmul::forward(rec, &first.product(&self.features, rows), &mut self.pre[0])?;
        activation::forward(rec, Activation::Gelu, &self.pre[0], &mut self.hidden[0])?;
        matmul::forward(rec, &second.product(&self.hidden[0], rows), &mut self.pre[1])?;
        activation::forward(rec, Activation::Gelu, &self.pre[1], &mut self.hidden[1])?;
        matmul::forward(rec, &third.product(&self.hidden[1], rows), &mut self.logits)
    }

    fn backward(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        let rows = self.config.batch;
        let [first, second, third] = &mut self.layers;
        let [v_pre0, v_pre1] = &mut self.v_pre;
        let grad = |pre| Epilogue::Grad(Activation::Gelu, pre);
        third.gradients(rec, &self.hidden[1], &self.v_logits)?;
        let plain = Product::plain(&self.v_logits, rows, &third.packed_t);
        matmul::forward(rec, &Product { epilogue: grad(&self.pre[1]), ..plain }, v_pre1)?;
        second.gradients(rec, &self.hidden[0], v_pre1)?;
        let plain = Product::plain(v_pre1, rows, &second.packed_t);
        matmul::forward(rec, &Product { epilogue: grad(&self.pre[0]), ..plain }, v_pre0)?;
        first.gradients(rec, &self.features, v_pre0)
    }
}

impl TrainedLinear {
    fn new(
        device: &Device,
        index: usize,
        inputs: usize,
        outputs: usize,
        rows: usize,
        init: &mut ChaCha20Rng,
    ) -> Result<Self, KernelError> {
        let name = |part: &str| format!("trainer.{index}.{part}");
        // torch.nn.Linear: both uniform in ±1/sqrt(inputs).
        let bound = 1.0 / (inputs as f64).sqrt();
        let mut draw = |n: usize| -> Vec<f32> {
            #[allow(clippy::cast_possible_truncation, reason = "weights are single precision")]
            (0..n).map(|_| ((2.0 * uniform_unit(init) - 1.0) * bound) as f32).collect()
        };
        Ok(Self {
            weight: device.buffer_from(&name("weight"), &draw(inputs * outputs))?,
            bias: device.buffer_from(&name("bias"), &draw(outputs))?,
            packed: PackedWeight::zeros(device, &name("packed"), outputs, inputs)?,
            packed_t: PackedWeight::zeros(device, &name("packed_t"), inputs, outputs)?,
            v_weight: device.buffer(&name("v_weight"), inputs * outputs)?,
            v_bias: device.buffer(&name("v_bias"), outputs)?,
            scratch: GradScratch::new(device, &name("scratch"), rows, outputs, inputs)?,
            weight_state: AdamState::new(device, &name("weight"), inputs * outputs)?,
            bias_state: AdamState::new(device, &name("bias"), outputs)?,
            inputs,
            outputs,
        })
    }

    fn product<'a>(&'a self, input: &'a Buffer<f32>, rows: usize) -> Product<'a> {
        Product { bias: Some(&self.bias), ..Product::plain(input, rows, &self.packed) }
    }

    fn pack(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        let stride = self.inputs;
        pack::gather(rec, &self.weight, Order::Rows { stride }, &mut self.packed)?;
        pack::gather(rec, &self.weight, Order::Columns { stride }, &mut self.packed_t)
    }

    fn gradients(&mut self, rec: &mut Recorder, input: &Buffer<f32>, v_out: &Buffer<f32>) -> Result<(), KernelError> {
        matmul::weight_gradient(rec, input, v_out, &mut self.scratch, &mut self.v_weight)?;
        column_sum::forward(rec, v_out, &mut self.v_bias)
    }
}
