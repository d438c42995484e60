//! The distance of two clips and its gradient: the way through the network and back, some frames at a time.

use guard4d_kernels::image::crop::{self, Cells, Crop, Window};
use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::loss::Term;
use guard4d_kernels::loss::lpips::{self, LpipsSums, Tap};
use guard4d_kernels::nn::activation::Activation;
use guard4d_kernels::nn::conv2d::{self, Conv2d};
use guard4d_kernels::nn::max_pool::{self, MaxPool};
use guard4d_kernels::shape::Accumulate;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::network::{Lpips, LpipsScore, NUM_TAPS, stacked_taps};
use super::weights::Layer;
use crate::error::EngineError;

/// Bytes of working memory up to which frames go through the network together.
const CHUNK_BYTES: usize = 64 << 20;

/// Two clips that are compared.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// Clip that gets the gradient `[F, H, W, 4]`.
    pub image: &'a Buffer<f32>,
    /// What it is compared with `[F, H, W, 4]`.
    pub reference: &'a Buffer<f32>,
    /// Height and width of their frames.
    pub full: ImageSize,
    /// First row and column of the part that is compared.
    pub corner: [usize; 2],
}

/// Where the gradient of a distance goes.
#[derive(Debug)]
pub struct LpipsGradient<'a> {
    /// dL/d`image` of a [`Pair`] `[F, H, W, 4]` (+=).
    pub v_image: &'a mut Buffer<f32>,
    /// Factor of the distance in the loss.
    pub weight: f32,
}

/// What is known of the pictures that others are compared with. However it is, the results are the same to the bit.
#[derive(Debug)]
pub enum Reference<'a> {
    /// Nothing.
    Unknown,
    /// Nothing yet; their features are left here.
    Keep(&'a mut LpipsFeatures),
    /// Their features, so that the pictures themselves are not read.
    Kept(&'a LpipsFeatures),
}

/// Features of pictures at all taps: the same as long as the pictures are.
#[derive(Debug)]
pub struct LpipsFeatures {
    /// Of the frames that go through the network together, of each tap `[chunk, H', W', C]`.
    chunks: Vec<Vec<Buffer<f32>>>,
}

/// Working memory for parts of one size, and the values of its last use.
#[derive(Debug)]
pub struct LpipsPass {
    size: ImageSize,
    frames: usize,
    /// Frames that go through the network together; divides `frames`.
    chunk: usize,
    cells: Cells,
    /// Input of the network `[chunk, ...]`: the references, then the pictures.
    input: Buffer<f32>,
    v_input: Buffer<f32>,
    layers: Vec<LayerState>,
    sums: LpipsSums,
    /// `[frames / chunk, NUM_TAPS]`
    values: Buffer<f32>,
}

/// What a layer leaves behind of a chunk.
#[derive(Debug)]
struct LayerState {
    shape: LayerShape,
    /// Output of the pooling in front of it, and its gradient; without a pooling they are empty.
    pooled: Buffer<f32>,
    v_pooled: Buffer<f32>,
    /// Output of the ReLU, and the gradient of the ReLU's input.
    y: Buffer<f32>,
    v_y: Buffer<f32>,
    /// Output of the ReLU for the references; empty where there is no tap.
    reference: Buffer<f32>,
}

/// Sizes of a layer, for one frame.
#[derive(Clone, Copy, Debug)]
struct LayerShape {
    pool: Option<MaxPool>,
    conv: Conv2d,
    out: [usize; 2],
    channels: usize,
}

impl LayerShape {
    fn new(layer: &Layer, input: [usize; 2]) -> Self {
        let pool = layer.pool.map(|pool| MaxPool {
            frames: 1,
            height: input[0],
            width: input[1],
            channels: layer.channels[0],
            side: pool.side,
            stride: pool.stride,
        });
        let (height, width) = pool.map_or((input[0], input[1]), |pool| pool.out_size());
        // The border of a layer with a stride is part of its cells.
        let padding = if layer.stride > 1 { 0 } else { layer.padding };
        let conv = Conv2d { frames: 1, height, width, padding };
        let (height, width) = conv.out_size(stacked_taps(layer));
        Self { pool, conv, out: [height, width], channels: layer.channels[1] }
    }

    fn out_len(&self) -> usize {
        self.out[0] * self.out[1] * self.channels
    }

    fn pooled_len(&self) -> usize {
        self.pool.map_or(0, |pool| pool.lens().1)
    }

    fn pool(&self, frames: usize) -> Option<MaxPool> {
        self.pool.map(|pool| MaxPool { frames, ..pool })
    }

    fn conv(&self, frames: usize) -> Conv2d {
        Conv2d { frames, ..self.conv }
    }
}

/// Cells that the first layer takes: of its stride, as many as its filters reach.
fn cells_of(first: &Layer, size: ImageSize) -> Cells {
    let cells = |pixels: usize| match first.stride {
        1 => pixels,
        stride => match (pixels + 2 * first.padding).checked_sub(first.taps) {
            Some(rest) => rest / stride + stacked_taps(first),
            None => 0,
        },
    };
    let padding = if first.stride > 1 { first.padding } else { 0 };
    Cells { grid: [cells(size.height), cells(size.width)], patch: first.stride, padding }
}

/// Sizes of all layers; `None` where one has nothing left to look at.
fn shapes(layers: &[Layer], cells: &Cells) -> Option<Vec<LayerShape>> {
    let mut size = cells.grid;
    let mut shapes = Vec::new();
    for layer in layers {
        let shape = LayerShape::new(layer, size);
        if shape.out.contains(&0) || shape.pool.is_some_and(|pool| pool.lens().1 == 0) {
            return None;
        }
        size = shape.out;
        shapes.push(shape);
    }
    Some(shapes)
}

/// Most frames whose memory stays within the limit and that divide all of them; at least one.
fn chunk_of(frames: usize, bytes_per_frame: usize, limit: usize) -> usize {
    let fits = |chunk: &usize| frames.is_multiple_of(*chunk) && chunk * bytes_per_frame <= limit;
    (1..=frames).rev().find(fits).unwrap_or(1)
}

impl LayerState {
    fn new(device: &Device, shape: LayerShape, chunk: usize, is_tapped: bool) -> Result<Self, KernelError> {
        Ok(Self {
            pooled: device.buffer("lpips.pooled", chunk * shape.pooled_len())?,
            v_pooled: device.buffer("lpips.v_pooled", chunk * shape.pooled_len())?,
            y: device.buffer("lpips.y", chunk * shape.out_len())?,
            v_y: device.buffer("lpips.v_y", chunk * shape.out_len())?,
            reference: device.buffer("lpips.reference", if is_tapped { chunk * shape.out_len() } else { 0 })?,
            shape,
        })
    }
}

impl LpipsFeatures {
    /// Device bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.chunks.iter().flatten().map(|tap| (size_of::<f32>() * tap.len()) as u64).sum()
    }
}

impl LpipsPass {
    /// Device bytes that the features of what it compares with take, if they are kept.
    #[must_use]
    pub fn features_bytes(&self) -> u64 {
        let chunk: usize = self.layers.iter().map(|state| state.reference.len()).sum();
        (size_of::<f32>() * chunk * (self.frames / self.chunk)) as u64
    }

    /// Values of the last use, for [`LpipsPass::score`].
    #[must_use]
    pub fn values(&self) -> &Buffer<f32> {
        &self.values
    }

    /// The distance that `values` say.
    #[must_use]
    pub fn score(&self, values: &[f32]) -> LpipsScore {
        let mut per_tap = [0.0; NUM_TAPS];
        for row in values.chunks_exact(NUM_TAPS) {
            per_tap.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(*v));
        }
        LpipsScore { per_tap }
    }
}

/// Copies what the layers made of the references to where the comparison finds it.
fn leave(
    rec: &mut Recorder,
    layers: &mut [LayerState],
    kept: Option<&mut Vec<Buffer<f32>>>,
) -> Result<(), KernelError> {
    let mut kept = kept.map(|taps| taps.iter_mut());
    for LayerState { y, reference, .. } in layers.iter_mut().filter(|state| !state.reference.is_empty()) {
        let into = kept.as_mut().and_then(Iterator::next).unwrap_or(reference);
        rec.copy(y, 0, into, 0, y.len())?;
    }
    Ok(())
}

impl Lpips {
    /// Room for `frames` frames of this size; nothing is allocated afterwards.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for frames that are too small for the network; when memory runs out.
    pub fn pass(&self, size: ImageSize, frames: usize) -> Result<LpipsPass, EngineError> {
        self.pass_within(size, frames, CHUNK_BYTES)
    }

    /// The same where as many frames go through the network together as take no more than `chunk_bytes`, at least one.
    ///
    /// # Errors
    /// As [`Lpips::pass`].
    pub fn pass_within(&self, size: ImageSize, frames: usize, chunk_bytes: usize) -> Result<LpipsPass, EngineError> {
        let layers: Vec<Layer> = self.layers.iter().map(|(layer, _)| *layer).collect();
        let cells = cells_of(&layers[0], size);
        let shapes = shapes(&layers, &cells).ok_or_else(|| EngineError::Usage {
            what: format!("pictures for LPIPS with {}", self.net),
            got: format!("{} x {} px", size.width, size.height),
            expected: format!("at least {} px both ways", self.net.min_side_px()),
        })?;
        // At most three of each: of references, of pictures, of gradients.
        let floats: usize = shapes.iter().map(|s| 3 * (s.out_len() + s.pooled_len())).sum::<usize>() + 3 * cells.len(1);
        let chunk = chunk_of(frames, floats * size_of::<f32>(), chunk_bytes);
        let device = &self.device;
        let largest = shapes.iter().map(|shape| shape.out[0] * shape.out[1]).max().unwrap_or(0);
        let states = shapes.into_iter().zip(&layers);
        let layers = states.map(|(shape, layer)| LayerState::new(device, shape, chunk, layer.is_tapped));
        Ok(LpipsPass {
            size,
            frames,
            chunk,
            cells,
            input: device.buffer("lpips.input", cells.len(chunk))?,
            v_input: device.buffer("lpips.v_input", cells.len(chunk))?,
            layers: layers.collect::<Result<_, _>>()?,
            sums: LpipsSums::new(device, chunk * largest)?,
            values: device.buffer("lpips.values", frames.div_ceil(chunk) * NUM_TAPS)?,
        })
    }

    /// Room for the features of what `pass` compares with.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn features(&self, pass: &LpipsPass) -> Result<LpipsFeatures, KernelError> {
        let lens: Vec<usize> = pass.layers.iter().map(|state| state.reference.len()).filter(|len| *len > 0).collect();
        let tap = |len: &usize| self.device.buffer("lpips.kept", *len);
        let chunk = |_| lens.iter().map(tap).collect::<Result<_, _>>();
        Ok(LpipsFeatures { chunks: (0..pass.frames / pass.chunk).map(chunk).collect::<Result<_, _>>()? })
    }

    /// The distance of two clips, mean over their frames, and if asked for its gradient.
    ///
    /// # Shapes
    /// in `pair` · out `gradient` inside the part that is compared · `pass.values()` (=)
    /// # Equation: Zhang et al. 2018, eq. 1, version 0.1 of their weights and code
    /// # Determinism: bitwise; sums in a fixed order, no atomics
    ///
    /// # Errors
    /// [`KernelError::Shape`] when a buffer does not fit.
    pub fn step(
        &self,
        rec: &mut Recorder,
        pass: &mut LpipsPass,
        pair: &Pair<'_>,
        gradient: Option<LpipsGradient<'_>>,
    ) -> Result<(), KernelError> {
        self.step_with(rec, pass, pair, Reference::Unknown, gradient)
    }

    /// The same with what is known of the reference; its features are those of the same frames and part, by a pass of
    /// the same sizes.
    ///
    /// # Errors
    /// As [`Lpips::step`].
    pub fn step_with(
        &self,
        rec: &mut Recorder,
        pass: &mut LpipsPass,
        pair: &Pair<'_>,
        mut reference: Reference<'_>,
        mut gradient: Option<LpipsGradient<'_>>,
    ) -> Result<(), KernelError> {
        for (chunk, first) in (0..pass.frames).step_by(pass.chunk).enumerate() {
            let window =
                Window { frame: first, frames: pass.chunk, corner: pair.corner, size: pass.size, full: pair.full };
            let crop = Crop { window, cells: pass.cells };
            if !matches!(reference, Reference::Kept(_)) {
                crop::forward(rec, &crop, &self.input, pair.reference, &mut pass.input, 0)?;
                self.forward(rec, pass)?;
            }
            match &mut reference {
                Reference::Unknown => leave(rec, &mut pass.layers, None)?,
                Reference::Keep(features) => leave(rec, &mut pass.layers, Some(&mut features.chunks[chunk]))?,
                Reference::Kept(_) => {}
            }
            crop::forward(rec, &crop, &self.input, pair.image, &mut pass.input, 0)?;
            self.forward(rec, pass)?;
            let known = match &reference {
                Reference::Unknown => None,
                Reference::Keep(features) => Some(&features.chunks[chunk]),
                Reference::Kept(features) => Some(&features.chunks[chunk]),
            };
            let weight = gradient.as_ref().map(|gradient| gradient.weight);
            self.compare_and_return(rec, pass, chunk, known, weight)?;
            if let Some(LpipsGradient { v_image, .. }) = &mut gradient {
                crop::backward(rec, &crop, &self.input, &pass.v_input, v_image)?;
            }
        }
        Ok(())
    }

    /// Features of all layers.
    fn forward(&self, rec: &mut Recorder, pass: &mut LpipsPass) -> Result<(), KernelError> {
        let frames = pass.chunk;
        for (i, (_, filters)) in self.layers.iter().enumerate() {
            let (before, from) = pass.layers.split_at_mut(i);
            let LayerState { shape, pooled, y, .. } = &mut from[0];
            let x = before.last().map_or(&pass.input, |state| &state.y);
            let x = match shape.pool(frames) {
                Some(pool) => {
                    max_pool::forward(rec, &pool, x, pooled)?;
                    &*pooled
                }
                None => x,
            };
            conv2d::forward(rec, &shape.conv(frames), filters, x, Activation::Relu, y)?;
        }
        Ok(())
    }

    /// Distances of all taps, and with a weight the gradient of the input, from the last layer to the first.
    fn compare_and_return(
        &self,
        rec: &mut Recorder,
        pass: &mut LpipsPass,
        chunk: usize,
        known: Option<&Vec<Buffer<f32>>>,
        weight: Option<f32>,
    ) -> Result<(), KernelError> {
        let frames = pass.chunk;
        let mut slot = (chunk + 1) * NUM_TAPS;
        let mut accumulate = Accumulate::Overwrite;
        for (i, (layer, filters)) in self.layers.iter().enumerate().rev() {
            let (before, from) = pass.layers.split_at_mut(i);
            let LayerState { shape, v_pooled, y, v_y, reference, .. } = &mut from[0];
            if layer.is_tapped {
                slot -= 1;
                let rows = frames * shape.out[0] * shape.out[1];
                let mean_over = rows / frames * pass.frames;
                let tap = slot % NUM_TAPS;
                let reference = known.map_or(&*reference, |taps| &taps[tap]);
                let tap = Tap { features: y, reference, weight: &self.heads[tap], rows, mean_over };
                let term = Term { values: &mut pass.values, slot, weight: weight.unwrap_or(0.0), accumulate };
                lpips::step(rec, &tap, v_y, term, &mut pass.sums)?;
            }
            if weight.is_none() {
                continue;
            }
            accumulate = Accumulate::Add;
            let conv = &shape.conv(frames);
            match (before.last_mut(), shape.pool(frames)) {
                // A tap passes the gradient through its ReLU itself.
                (Some(previous), Some(pool)) => {
                    conv2d::backward(rec, conv, filters, v_y, None, v_pooled)?;
                    max_pool::backward(rec, &pool, &previous.y, v_pooled, &mut previous.v_y)?;
                }
                (Some(previous), None) => {
                    let gate = (!self.layers[i - 1].0.is_tapped).then_some(&previous.y);
                    conv2d::backward(rec, conv, filters, v_y, gate, &mut previous.v_y)?;
                }
                (None, _) => conv2d::backward(rec, conv, filters, v_y, None, &mut pass.v_input)?,
            }
        }
        Ok(())
    }
}
