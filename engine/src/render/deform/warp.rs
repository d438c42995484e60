//! A Deformable-3DGS network on the device.

use guard4d_kernels::nn::activation::{self, Activation};
use guard4d_kernels::nn::matmul::{self, Epilogue, Product};
use guard4d_kernels::nn::pack::{LANES, PackedWeight};
use guard4d_kernels::splat::deform::DeformedOut;
use guard4d_kernels::splat::project::RawSplats;
use guard4d_kernels::splat::warp::{self, Shift, WARP_COLUMNS};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::network::{CHUNK, Layer, Matrix};
use super::state::SplatState;
use crate::error::EngineError;
use crate::scene::Gaussians;
use crate::scene::deformation::Linear;
use crate::scene::warp::{POSITION_FLOATS, PositionHead, SKIP, WarpWeights, encoded_position};

/// Columns of an encoded position, padded.
const ENCODED: usize = POSITION_FLOATS.next_multiple_of(LANES);

/// First column of each head in the rows that [`warp`] reads.
const POSITION_COLUMN: usize = 0;
const SCALE_COLUMN: usize = 4;
const ROTATION_COLUMN: usize = 8;
const TWIST_COLUMN: usize = 12;

/// A network with its working memory. Positions do not change with time, so they are encoded once; what the time adds
/// to the layers that take it is the same for all splats, and goes into their biases.
#[derive(Debug)]
pub(super) struct WarpField {
    weights: WarpWeights,
    encoded: Buffer<f32>,
    layers: Vec<Layer>,
    /// The part of layer [`SKIP`] that takes the layer before.
    skip: PackedWeight,
    skipped: Buffer<f32>,
    before_relu: Buffer<f32>,
    heads: Layer,
    shift: Shift,
    chunk: [Buffer<f32>; 4],
    out: [Buffer<f32>; 3],
    rows: usize,
}

impl WarpField {
    /// Uploads a network for the splats `gaussians`.
    pub(super) fn new(device: &Device, weights: &WarpWeights, gaussians: &Gaussians) -> Result<Self, EngineError> {
        let rows = gaussians.len().min(CHUNK);
        let mut encoded = vec![0.0; ENCODED * gaussians.len()];
        for (row, mean) in encoded.chunks_exact_mut(ENCODED).zip(&gaussians.means) {
            row[..POSITION_FLOATS].copy_from_slice(&encoded_position(*mean));
        }
        let width = weights.layers[0].outputs;
        let positions = |linear: &Linear| linear.columns(0..POSITION_FLOATS);
        let mut layers = Vec::with_capacity(weights.layers.len());
        for (index, linear) in weights.layers.iter().enumerate() {
            let takes_encoding = matches!(index, 0 | SKIP);
            let mut matrix = Matrix::zeros(width, if takes_encoding { ENCODED } else { width });
            let part = if takes_encoding { positions(linear) } else { linear.clone() };
            matrix.put(&part, 0, 0, |j| j);
            layers.push(matrix.layer(device, Activation::Relu, rows)?);
        }
        let skip = &weights.layers[SKIP];
        let before = skip.columns(skip.inputs - width..skip.inputs);
        let mut heads = Matrix::zeros(WARP_COLUMNS, width);
        let shift = match &weights.position {
            PositionHead::Offset(offset) => {
                heads.put(offset, POSITION_COLUMN, 0, |j| j);
                Shift::Offset
            }
            PositionHead::Screw { w, v } => {
                heads.put(v, POSITION_COLUMN, 0, |j| j);
                heads.put(w, TWIST_COLUMN, 0, |j| j);
                Shift::Screw
            }
        };
        heads.put(&weights.scaling, SCALE_COLUMN, 0, |j| j);
        heads.put(&weights.rotation, ROTATION_COLUMN, 0, |j| j);
        let part = |name: &str, floats: usize| device.buffer(&format!("warp.{name}"), floats * rows);
        Ok(Self {
            weights: weights.clone(),
            encoded: device.buffer_from("warp.encoded", &encoded)?,
            layers,
            skip: PackedWeight::new(device, "warp.skip", &before.weight, width, width)?,
            skipped: part("skipped", width)?,
            before_relu: part("before_relu", width)?,
            heads: heads.layer(device, Activation::Identity, rows)?,
            shift,
            chunk: [part("means", 4)?, part("scales", 4)?, part("quats", 4)?, part("encoded_rows", ENCODED)?],
            out: [part("warped_means", 4)?, part("warped_scales", 4)?, part("warped_quats", 4)?],
            rows,
        })
    }

    /// The splats at `time`.
    pub(super) fn deform(
        &mut self,
        device: &Device,
        canonical: &SplatState,
        time: f32,
    ) -> Result<SplatState, EngineError> {
        self.set_time(time)?;
        let n = canonical.len();
        let mut out = SplatState::like(device, canonical)?;
        let mut first = 0;
        while first < n {
            // The last chunk is whole too: it begins earlier and repeats some splats.
            let start = first.min(n - self.rows);
            let mut rec = device.recorder()?;
            let sources = [&canonical.means, &canonical.scales, &canonical.quats, &self.encoded];
            for ((source, floats), target) in sources.into_iter().zip([4, 4, 4, ENCODED]).zip(&mut self.chunk) {
                rec.copy(source, floats * start, target, 0, floats * self.rows)?;
            }
            self.run(&mut rec)?;
            let targets = [&mut out.means, &mut out.scales, &mut out.quats];
            for (source, target) in self.out.iter().zip(targets) {
                rec.copy(source, 0, target, 4 * start, 4 * self.rows)?;
            }
            rec.submit()?;
            first += self.rows;
        }
        Ok(out)
    }

    /// Puts what the time adds into the biases of the layers that take the encoding.
    fn set_time(&mut self, time: f32) -> Result<(), KernelError> {
        let encoded = self.weights.encoded_time(time);
        for index in [0, SKIP] {
            let linear = &self.weights.layers[index];
            let times = linear.columns(POSITION_FLOATS..POSITION_FLOATS + encoded.len());
            self.layers[index].bias.write(&times.apply(&encoded))?;
        }
        Ok(())
    }

    fn run(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        let [means, scales, quats, encoded] = &self.chunk;
        let mut input = encoded;
        for (index, layer) in self.layers.iter_mut().enumerate() {
            if index == SKIP {
                matmul::forward(rec, &Product::plain(input, self.rows, &self.skip), &mut self.skipped)?;
                let product = Product {
                    bias: Some(&layer.bias),
                    epilogue: Epilogue::Add(&self.skipped),
                    ..Product::plain(encoded, self.rows, &layer.weight)
                };
                matmul::forward(rec, &product, &mut self.before_relu)?;
                activation::forward(rec, Activation::Relu, &self.before_relu, &mut layer.output)?;
            } else {
                layer.forward(rec, input, self.rows, layer.activation)?;
            }
            input = &layer.output;
        }
        self.heads.forward(rec, input, self.rows, Activation::Identity)?;
        let raw = RawSplats { means, scales, quats, buckets: None };
        let [means, scales, quats] = &mut self.out;
        warp::apply(rec, raw, &self.heads.output, self.shift, DeformedOut { means, scales, quats })
    }
}
