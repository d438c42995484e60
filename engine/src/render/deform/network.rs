//! The deformation network on the device: HexPlane features, shared layers, heads.

use std::sync::Arc;

use guard4d_kernels::nn::activation::Activation;
use guard4d_kernels::nn::matmul::{self, Epilogue, Product};
use guard4d_kernels::nn::pack::{LANES, PackedWeight};
use guard4d_kernels::splat::deform::{self, ALL_COLUMNS, DeformedOut, GEOMETRY_COLUMNS, Heads, RotationUpdate};
use guard4d_kernels::splat::hexplane::{self, Planes};
use guard4d_kernels::splat::project::RawSplats;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::state::SplatState;
use crate::error::EngineError;
use crate::scene::DeformationWeights;
use crate::scene::deformation::{Head, Linear, TIME_AXIS};
use crate::scene::gaussians::SH_FLOATS;

/// Splats that go through the network at once: what a row needs of working memory is several KB.
pub(super) const CHUNK: usize = 16_384;

/// First column of each head in the rows that [`deform`] reads.
const POSITION_COLUMN: usize = 0;
const OPACITY_COLUMN: usize = 3;
const SCALE_COLUMN: usize = 4;
const ROTATION_COLUMN: usize = 8;
const SH_COLUMN: usize = GEOMETRY_COLUMNS;

/// A linear layer with a ReLU behind it or not, sizes padded with zeros, and room for its output.
#[derive(Debug)]
pub(super) struct Layer {
    pub(super) weight: PackedWeight,
    pub(super) bias: Buffer<f32>,
    pub(super) activation: Activation,
    pub(super) output: Buffer<f32>,
}

impl Layer {
    pub(super) fn forward(
        &mut self,
        rec: &mut Recorder,
        input: &Buffer<f32>,
        rows: usize,
        activation: Activation,
    ) -> Result<(), KernelError> {
        let product = Product {
            bias: Some(&self.bias),
            epilogue: Epilogue::Activate(activation),
            ..Product::plain(input, rows, &self.weight)
        };
        matmul::forward(rec, &product, &mut self.output)
    }
}

/// Weights of a layer before packing; rows and columns that stay zero are padding.
pub(super) struct Matrix {
    weight: Vec<f32>,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

impl Matrix {
    pub(super) fn zeros(outputs: usize, inputs: usize) -> Self {
        let outputs = outputs.next_multiple_of(LANES);
        Self { weight: vec![0.0; outputs * inputs], bias: vec![0.0; outputs], inputs, outputs }
    }

    /// Writes `layer` at (row, column); `place` maps the layer's inputs to columns behind that.
    pub(super) fn put(&mut self, layer: &Linear, row: usize, column: usize, place: impl Fn(usize) -> usize) {
        for (i, (weights, bias)) in layer.weight.chunks_exact(layer.inputs.max(1)).zip(&layer.bias).enumerate() {
            self.bias[row + i] = *bias;
            for (j, weight) in weights.iter().enumerate() {
                self.weight[(row + i) * self.inputs + column + place(j)] = *weight;
            }
        }
    }

    pub(super) fn layer(self, device: &Device, activation: Activation, rows: usize) -> Result<Layer, KernelError> {
        let weight = PackedWeight::new(device, "deform.weight", &self.weight, self.outputs, self.inputs)?;
        Ok(Layer {
            weight,
            bias: device.buffer_from("deform.bias", &self.bias)?,
            activation,
            output: device.buffer("deform.activations", rows * self.outputs)?,
        })
    }
}

/// Splats of one chunk, before and after.
#[derive(Debug)]
struct Chunk {
    raw: [Buffer<f32>; 3],
    deformed: [Buffer<f32>; 3],
    sh: Option<[Buffer<f32>; 2]>,
    features: Buffer<f32>,
}

/// A deformation network with its working memory.
#[derive(Debug)]
pub(super) struct Network {
    planes: Planes,
    layers: Vec<Layer>,
    rotation: RotationUpdate,
    chunk: Chunk,
    rows: usize,
    sizes: Sizes,
    bends: u32,
}

/// Sizes before padding.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    /// Levels of planes.
    levels: usize,
    /// Features of one level.
    channels: usize,
    /// Columns of the shared layers.
    width: usize,
    /// Number of shared layers.
    trunk: usize,
}

/// What the network computes on the way to the heads, row-major without padding; only comparisons ask for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HiddenRows {
    /// `[N, levels * channels]`
    pub feat: Vec<f32>,
    /// `[N, net_width]`: output of the shared layers, before the heads' ReLU.
    pub hidden: Vec<f32>,
}

impl Network {
    /// Uploads the network; `n` splats will go through it.
    pub(super) fn new(device: &Device, weights: &DeformationWeights, n: usize) -> Result<Self, KernelError> {
        let channels = weights.config.output_coordinate_dim;
        let planes: Vec<_> = weights.grids.iter().flatten().map(plane).collect();
        let planes = Planes::new(device, &planes, channels, weights.aabb)?;
        let rows = n.min(CHUNK);
        let deforms_sh = !weights.config.no_dshs;
        let layers = layers(device, weights, planes.features(), rows)?;
        let rotation = match (weights.config.no_dr, weights.config.apply_rotation) {
            (true, _) => RotationUpdate::Keep,
            (false, false) => RotationUpdate::Add,
            (false, true) => RotationUpdate::Multiply,
        };
        let splats = |name: &str| {
            let part = |what: &str| device.buffer(&format!("deform.{name}.{what}"), 4 * rows);
            Ok::<_, KernelError>([part("means")?, part("scales")?, part("quats")?])
        };
        let sh = |name: &str| device.buffer(name, SH_FLOATS * rows);
        let chunk = Chunk {
            raw: splats("raw")?,
            deformed: splats("deformed")?,
            sh: deforms_sh.then(|| Ok::<_, KernelError>([sh("deform.sh")?, sh("deform.deformed_sh")?])).transpose()?,
            features: device.buffer("deform.features", rows * planes.features())?,
        };
        let (levels, width, trunk) = (weights.grids.len(), weights.config.net_width, weights.feature_out.len());
        let sizes = Sizes { levels, channels, width, trunk };
        let bends = bends(weights.config.resolution[TIME_AXIS]);
        Ok(Self { planes, layers, rotation, chunk, rows, sizes, bends })
    }

    /// Even steps from time 0 to 1 of which each bend of the features is an end.
    pub(super) fn bends(&self) -> u32 {
        self.bends
    }

    /// Features and shared layers of all splats at `time`.
    pub(super) fn hidden(
        &mut self,
        device: &Device,
        canonical: &SplatState,
        time: f32,
    ) -> Result<HiddenRows, EngineError> {
        let n = canonical.len();
        let Sizes { levels, channels, width, trunk } = self.sizes;
        let mut found = HiddenRows::default();
        let mut first = 0;
        while first < n {
            let start = first.min(n - self.rows);
            let mut rec = device.recorder()?;
            self.load(&mut rec, canonical, start)?;
            let means = &self.chunk.raw[0];
            hexplane::forward(&mut rec, &self.planes, means, time, &mut self.chunk.features)?;
            let mut input = &self.chunk.features;
            for (i, layer) in self.layers[..trunk].iter_mut().enumerate() {
                let activation = if i + 1 == trunk { Activation::Identity } else { layer.activation };
                layer.forward(&mut rec, input, self.rows, activation)?;
                input = &layer.output;
            }
            rec.submit()?;
            // Rows that the chunk before has given already stay out.
            let seen = first - start;
            let feat = self.chunk.features.read()?;
            let padded = self.planes.features() / levels;
            found.feat.extend(feat.chunks(padded).skip(seen * levels).flat_map(|part| &part[..channels]));
            let hidden = input.read()?;
            let padded = width.next_multiple_of(LANES);
            found.hidden.extend(hidden.chunks(padded).skip(seen).flat_map(|row| &row[..width]));
            first += self.rows;
        }
        Ok(found)
    }

    /// The splats at `time`.
    pub(super) fn deform(
        &mut self,
        device: &Device,
        canonical: &SplatState,
        time: f32,
    ) -> Result<SplatState, EngineError> {
        let n = canonical.len();
        let mut out = SplatState::like(device, canonical)?;
        let sh_floats = if self.chunk.sh.is_some() { canonical.sh_coeffs().len() } else { 0 };
        let mut sh = device.buffer("moment.sh_coeffs", sh_floats)?;
        let mut first = 0;
        while first < n {
            // The last chunk is whole too: it begins earlier and repeats some splats.
            let start = first.min(n - self.rows);
            let mut rec = device.recorder()?;
            self.load(&mut rec, canonical, start)?;
            self.run(&mut rec, time)?;
            self.store(&mut rec, &mut out, &mut sh, start)?;
            rec.submit()?;
            first += self.rows;
        }
        if self.chunk.sh.is_some() {
            out.sh_coeffs = Arc::new(sh);
        }
        Ok(out)
    }

    fn load(&mut self, rec: &mut Recorder, from: &SplatState, start: usize) -> Result<(), KernelError> {
        let [means, scales, quats] = &mut self.chunk.raw;
        for (source, target) in [(&from.means, means), (&from.scales, scales), (&from.quats, quats)] {
            rec.copy(source, 4 * start, target, 0, 4 * self.rows)?;
        }
        match &mut self.chunk.sh {
            Some([raw, _]) => rec.copy(from.sh_coeffs(), SH_FLOATS * start, raw, 0, SH_FLOATS * self.rows),
            None => Ok(()),
        }
    }

    fn run(&mut self, rec: &mut Recorder, time: f32) -> Result<(), KernelError> {
        let [means, scales, quats] = &self.chunk.raw;
        hexplane::forward(rec, &self.planes, means, time, &mut self.chunk.features)?;
        let mut input = &self.chunk.features;
        for layer in &mut self.layers {
            layer.forward(rec, input, self.rows, layer.activation)?;
            input = &layer.output;
        }
        let heads = Heads { data: input, columns: input.len() / self.rows };
        let raw = RawSplats { means, scales, quats, buckets: None };
        let [means, scales, quats] = &mut self.chunk.deformed;
        deform::apply(rec, raw, heads, self.rotation, DeformedOut { means, scales, quats })?;
        match &mut self.chunk.sh {
            Some([raw, deformed]) => deform::apply_sh(rec, raw, heads, deformed),
            None => Ok(()),
        }
    }

    fn store(
        &self,
        rec: &mut Recorder,
        to: &mut SplatState,
        sh: &mut Buffer<f32>,
        start: usize,
    ) -> Result<(), KernelError> {
        let targets = [&mut to.means, &mut to.scales, &mut to.quats];
        for (source, target) in self.chunk.deformed.iter().zip(targets) {
            rec.copy(source, 0, target, 4 * start, 4 * self.rows)?;
        }
        match &self.chunk.sh {
            Some([_, deformed]) => rec.copy(deformed, 0, sh, SH_FLOATS * start, SH_FLOATS * self.rows),
            None => Ok(()),
        }
    }
}

/// Even steps from time 0 to 1 of which all samples of an axis with so many are ends: they go from −1 to 1.
fn bends(samples: usize) -> u32 {
    let apart = u32::try_from(samples.saturating_sub(1)).unwrap_or(u32::MAX).max(1);
    if apart.is_multiple_of(2) { apart / 2 } else { apart }
}

fn plane(plane: &crate::scene::deformation::Plane) -> hexplane::Plane<'_> {
    hexplane::Plane { data: &plane.data, width: plane.width, height: plane.height }
}

/// Heads that are in use, with their first column. An unused one holds random weights and stays out.
fn used_heads(weights: &DeformationWeights) -> Vec<(&Head, usize)> {
    let config = &weights.config;
    let all = [
        (config.no_dx, &weights.pos_deform, POSITION_COLUMN),
        (config.no_ds, &weights.scales_deform, SCALE_COLUMN),
        (config.no_dr, &weights.rotations_deform, ROTATION_COLUMN),
        (config.no_do, &weights.opacity_deform, OPACITY_COLUMN),
        (config.no_dshs, &weights.shs_deform, SH_COLUMN),
    ];
    all.into_iter().filter(|(off, ..)| !off).map(|(_, head, column)| (head, column)).collect()
}

/// `feature_out`, then one layer with the hidden layers of all used heads side by side, then one
/// block-diagonal layer with their outputs. Every head begins with a ReLU, so the last shared layer
/// ends with one.
fn layers(
    device: &Device,
    weights: &DeformationWeights,
    features: usize,
    rows: usize,
) -> Result<Vec<Layer>, KernelError> {
    let width = weights.config.net_width;
    let padded_width = width.next_multiple_of(LANES);
    let channels = weights.config.output_coordinate_dim;
    let padded_channels = features / weights.grids.len().max(1);
    let feature_column = |j: usize| j / channels * padded_channels + j % channels;
    let mut layers = Vec::new();
    for (i, linear) in weights.feature_out.iter().enumerate() {
        let mut matrix = Matrix::zeros(width, if i == 0 { features } else { padded_width });
        if i == 0 {
            matrix.put(linear, 0, 0, feature_column);
        } else {
            matrix.put(linear, 0, 0, |j| j);
        }
        layers.push(matrix.layer(device, Activation::Relu, rows)?);
    }
    let heads = used_heads(weights);
    let columns = if weights.config.no_dshs { GEOMETRY_COLUMNS } else { ALL_COLUMNS };
    let mut hidden = Matrix::zeros(heads.len().max(1) * padded_width, padded_width);
    let mut out = Matrix::zeros(columns, heads.len().max(1) * padded_width);
    for (i, (head, column)) in heads.into_iter().enumerate() {
        hidden.put(&head.hidden, i * padded_width, 0, |j| j);
        out.put(&head.out, column, i * padded_width, |j| j);
    }
    layers.push(hidden.layer(device, Activation::Relu, rows)?);
    layers.push(out.layer(device, Activation::Identity, rows)?);
    Ok(layers)
}
