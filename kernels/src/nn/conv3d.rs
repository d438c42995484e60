//! 3×3×3 convolution over clips, stride 1, channels last, with its gradients.

use super::pack::Precision;
use crate::error::KernelError;
use crate::registry::nn::{
    conv3d_bwd, conv3d_bwd_coop, conv3d_bwd_tile, conv3d_correlate, conv3d_correlate_tile, conv3d_fwd, conv3d_fwd_coop,
    conv3d_fwd_tile, conv3d_reduce, conv3d_transpose,
};
use crate::shape::{Accumulate, ClipShape, dim, dim_signed, expect_len};
use crate::vk::{Buffer, Cooperation, Device, Grid, KernelFamily, Recorder};

/// Taps of the kernel.
pub const TAPS: usize = 27;
/// Taps along frames.
const FRAME_TAPS: u32 = 3;
/// Pixels of a row that one workgroup owns.
const SPAN_PX: usize = 32;
/// Rows of one workgroup of the kernels over cooperative matrices: `TILE_H` of `glsl/lib/conv3d_coop.glsl`.
const COOP_ROWS: u32 = 8;
/// Source channels of one of their stages, and outputs of a workgroup: `CHANNELS` there.
const COOP_CHANNELS: u32 = 16;
/// Rows of one workgroup of the tile kernels: `TILE_H` of `glsl/lib/conv3d_halo.glsl`.
const TILE_ROWS: usize = 16;
/// The same of the weight gradient: `TILE_H` of `glsl/nn/conv3d_correlate_tile.comp`.
const GRADIENT_TILE_ROWS: usize = 4;
/// Most tiles of a chunk: at 48 turns of a loop per tile or fewer, some drivers stop after 65,535.
const MAX_CHUNK_TILES: usize = 1024;
/// Widest block of output texels in one workgroup; four keep the accumulators in the L1 cache.
const MAX_BLOCK4: u32 = 4;
/// Widest block of output texels of the weight gradient, whose accumulators also span the input.
const MAX_GRADIENT_BLOCK4: u32 = 2;
/// Vector steps of the weight gradient per loop iteration; fewer cost a quarter more, more gain nothing.
const UNROLL: i32 = 4;
/// Vector steps of one chunk of the weight gradient: long enough to hide a workgroup's start.
const STEPS_PER_CHUNK: usize = 256;
/// Most chunks wanted for occupancy; longer clips get longer chunks.
const WANTED_CHUNKS: usize = 64;
/// Most vector steps of a chunk: some drivers stop loops after 65,535 iterations.
const MAX_STEPS: usize = 16_384;

/// What lies outside an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Padding {
    /// Zeros.
    Zero,
    /// The nearest entry.
    Replicate,
    /// The mirror image without the border entry; needs two entries.
    Reflect,
}

impl Padding {
    fn code(self) -> u32 {
        match self {
            Self::Zero => 0,
            Self::Replicate => 1,
            Self::Reflect => 2,
        }
    }
}

/// Whether `[Co]` additive terms follow the weights in their buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bias {
    /// `weight [27, Ci/4, Co, 4]` alone.
    None,
    /// `[Co]` behind the weights.
    Added,
}

/// What happens to each output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// max(0, y)
    Relu,
}

/// One layer applied to clips of one shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conv3d {
    /// Clip shape, kept by the layer.
    pub shape: ClipShape,
    /// `Ci`, a multiple of four.
    pub in_channels: usize,
    /// `Co`, a multiple of four.
    pub out_channels: usize,
    /// Padding along frames.
    pub time: Padding,
    /// Padding along rows and columns.
    pub space: Padding,
    /// Additive terms.
    pub bias: Bias,
    /// Output function.
    pub activation: Activation,
    /// With [`Precision::Half`] the output and the gradient to the input come from cooperative matrices: factors are
    /// rounded to 16-bit floats, gradients with a scale that they have in common, and sums are 32-bit floats. Anything
    /// else is 32-bit floats throughout, as is the gradient to the weights.
    pub precision: Precision,
}

impl Conv3d {
    /// Values in the weight buffer.
    #[must_use]
    pub fn weight_len(&self) -> usize {
        let bias = if self.bias == Bias::Added { self.out_channels } else { 0 };
        TAPS * self.in_channels * self.out_channels + bias
    }

    /// Rearranges PyTorch's `[Co, Ci, 3, 3, 3]` into `[27, Ci/4, Co, 4]`; channels beyond the given
    /// ones (3 padded to 4) become zero.
    #[must_use]
    pub fn pack(&self, weight: &[f32], in_given: usize, out_given: usize) -> Vec<f32> {
        let mut packed = vec![0.0; self.weight_len()];
        for (from, to) in self.order(in_given, out_given) {
            packed[to] = weight[from];
        }
        packed
    }

    /// The inverse of [`Conv3d::pack`], without the bias.
    #[must_use]
    pub fn unpack(&self, packed: &[f32], in_given: usize, out_given: usize) -> Vec<f32> {
        let mut weight = vec![0.0; out_given * in_given * TAPS];
        for (to, from) in self.order(in_given, out_given) {
            weight[to] = packed[from];
        }
        weight
    }

    fn order(&self, in_given: usize, out_given: usize) -> impl Iterator<Item = (usize, usize)> {
        let (in4, out) = (self.in_channels / 4, self.out_channels);
        (0..out_given * in_given * TAPS).map(move |i| {
            let (tap, ci, co) = (i % TAPS, i / TAPS % in_given, i / TAPS / in_given);
            (i, ((tap * in4 + ci / 4) * out + co) * 4 + ci % 4)
        })
    }

    fn check(&self) -> Result<(), KernelError> {
        let refuse = |buffer, got: String, expected: &str| {
            Err(KernelError::Shape { kernel: KERNEL, buffer, got, expected: expected.to_owned() })
        };
        for (name, n) in [("in_channels", self.in_channels), ("out_channels", self.out_channels)] {
            if n == 0 || !n.is_multiple_of(4) {
                return refuse(name, n.to_string(), "a positive multiple of 4");
            }
        }
        let ClipShape { frames, height, width } = self.shape;
        for (name, n, padding) in
            [("frames", frames, self.time), ("height", height, self.space), ("width", width, self.space)]
        {
            if n == 1 && padding == Padding::Reflect {
                return refuse(name, n.to_string(), "at least 2 for reflection");
            }
        }
        Ok(())
    }

    fn rows(&self) -> usize {
        self.shape.frames * self.shape.height
    }

    /// Tiles of the weight gradient's tile kernel.
    fn gradient_tiles(&self) -> usize {
        let ClipShape { frames, height, width } = self.shape;
        frames * height.div_ceil(GRADIENT_TILE_ROWS) * width.div_ceil(SPAN_PX)
    }

    /// How much of the clip one partial weight gradient covers: rows for lanes, tiles for tiles.
    fn chunk_parts(&self, family: KernelFamily) -> usize {
        match family {
            KernelFamily::Lanes => {
                let spans = self.shape.width.div_ceil(8).max(1);
                let steps = self.rows() * spans;
                let chunks = (steps / STEPS_PER_CHUNK).clamp(1, WANTED_CHUNKS).max(steps.div_ceil(MAX_STEPS));
                self.rows().div_ceil(chunks).max(1)
            }
            KernelFamily::Tiles => {
                let chunks = WANTED_CHUNKS.max(self.gradient_tiles().div_ceil(MAX_CHUNK_TILES));
                self.gradient_tiles().div_ceil(chunks).max(1)
            }
        }
    }

    fn chunks(&self, family: KernelFamily) -> usize {
        let parts = match family {
            KernelFamily::Lanes => self.rows(),
            KernelFamily::Tiles => self.gradient_tiles(),
        };
        parts.div_ceil(self.chunk_parts(family))
    }

    /// Texels of one partial weight gradient, bias included.
    fn partial_texels(&self) -> usize {
        self.weight_len().div_ceil(4)
    }

    /// The device's cooperative matrices where this layer takes them: by its precision, and where their subgroups can
    /// share a workgroup's tile.
    fn cooperation(&self, rec: &Recorder) -> Result<Option<Cooperation>, KernelError> {
        if self.precision != Precision::Half {
            return Ok(None);
        }
        let matrices = rec.cooperation()?;
        let Cooperation { m, n, k, subgroups, .. } = matrices;
        let strips = dim(SPAN_PX) / m.max(1);
        let shared = dim(SPAN_PX).is_multiple_of(m)
            && subgroups.is_multiple_of(strips)
            && COOP_ROWS.is_multiple_of(subgroups / strips)
            && COOP_CHANNELS.is_multiple_of(n)
            && COOP_CHANNELS.is_multiple_of(k);
        Ok(shared.then_some(matrices))
    }

    /// Workgroups of a kernel over cooperative matrices with `width4` texels of outputs.
    fn coop_grid(&self, width4: u32) -> Grid {
        let ClipShape { frames, height, width } = self.shape;
        let blocks = (4 * width4).div_ceil(COOP_CHANNELS);
        Grid::groups(dim(width.div_ceil(SPAN_PX)), dim(height).div_ceil(COOP_ROWS), dim(frames) * blocks)
    }

    fn grid(&self, family: KernelFamily, blocks: u32) -> Grid {
        let ClipShape { frames, height, width } = self.shape;
        let rows = match family {
            KernelFamily::Lanes => height,
            KernelFamily::Tiles => height.div_ceil(TILE_ROWS),
        };
        Grid::groups(dim(width.div_ceil(SPAN_PX)), dim(rows), dim(frames) * blocks)
    }
}

/// The sizes that the programs of both families take.
macro_rules! clip_params {
    ($module:ident, $shape:expr $(, $field:ident: $value:expr)?) => {
        $module::Params {
            frames: dim_signed($shape.frames),
            height: dim_signed($shape.height),
            width: dim_signed($shape.width),
            $($field: dim_signed($value),)?
        }
    };
}

const KERNEL: &str = "nn/conv3d";

/// Largest divisor of `texels` up to `most`: what fits one workgroup.
fn block(texels: u32, most: u32) -> u32 {
    (1..=most).rev().find(|b| texels.is_multiple_of(*b)).unwrap_or(1)
}

/// Convolves a clip.
///
/// # Shapes
/// in `x` \[F,H,W,Ci\] · `weight` \[27,Ci/4,Co,4\] (+ \[Co\] with a bias), tap = (dt·3 + dy)·3 + dx ·
/// out `y` \[F,H,W,Co\] (=)
/// # Equation: y(t,y,x,o) = φ(b(o) + Σ w(o,i,dt,dy,dx) x(t+dt−1, y+dy−1, x+dx−1, i)), as PyTorch's `conv3d`
/// # Determinism: bitwise; no atomics
/// # Cost
/// 54·F·H·W·Ci·Co operations. Per block of 16 outputs lanes load each input 27 times, tiles 3.6 times (three frames, a
/// halo of 34×18 around 32×16 pixels), and 20 texels of shared memory per 256 products of an invocation. Cooperative
/// matrices load it 4 times (34×10 around 32×8).
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded; [`KernelError::Unsuitable`] for 16-bit floats on a device
/// without cooperative matrices.
pub fn forward(
    rec: &mut Recorder,
    conv: &Conv3d,
    x: &Buffer<f32>,
    weight: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    conv.check()?;
    let pixels = conv.shape.pixels();
    expect_len(KERNEL, "x", x, pixels * conv.in_channels)?;
    expect_len(KERNEL, "weight", weight, conv.weight_len())?;
    expect_len(KERNEL, "y", y, pixels * conv.out_channels)?;
    let (depth4, width4) = (dim(conv.in_channels / 4), dim(conv.out_channels / 4));
    let block4 = block(width4, MAX_BLOCK4);
    let grid = conv.grid(rec.family(), width4 / block4);
    /// Runs one program; they differ in the module that the types come from and in how they cut the clip.
    macro_rules! convolve {
        ($module:ident, $grid:expr, { $($size:ident),* }) => {{
            let spec = $module::Spec {
                depth4,
                width4,
                $($size,)*
                pad_t: conv.time.code(),
                pad_xy: conv.space.code(),
                bias: u32::from(conv.bias == Bias::Added),
                relu: u32::from(conv.activation == Activation::Relu),
            };
            rec.dispatch_spec($module::Bind { x, weight, y }, clip_params!($module, conv.shape), spec, $grid)
        }};
    }
    match (conv.cooperation(rec)?, rec.family()) {
        (Some(Cooperation { m: tm, n: tn, k: tk, subgroups, .. }), _) => {
            convolve!(conv3d_fwd_coop, conv.coop_grid(width4), { tm, tn, tk, subgroups })
        }
        (None, KernelFamily::Lanes) => convolve!(conv3d_fwd, grid, { block4 }),
        (None, KernelFamily::Tiles) => convolve!(conv3d_fwd_tile, grid, { block4 }),
    }
}

/// Working memory of the backward passes of one layer.
#[derive(Debug)]
pub struct Conv3dScratch {
    weight_t: Buffer<f32>,
    partial: Buffer<f32>,
}

impl Conv3dScratch {
    /// Memory for `conv`.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, conv: &Conv3d) -> Result<Self, KernelError> {
        conv.check()?;
        Ok(Self {
            weight_t: device.buffer("conv3d.weight_t", TAPS * conv.in_channels * conv.out_channels)?,
            partial: device.buffer("conv3d.partial", conv.chunks(device.family()) * conv.partial_texels() * 4)?,
        })
    }
}

/// Inputs of [`backward_input`].
#[derive(Clone, Copy, Debug)]
pub struct InputGradient<'a> {
    /// `[F,H,W,Co]`, gradient before this layer's activation.
    pub v_y: &'a Buffer<f32>,
    /// As in [`forward`].
    pub weight: &'a Buffer<f32>,
    /// `[F,H,W,Ci]`: this layer's input where a ReLU made it. The result is then the gradient before
    /// that ReLU, which is what the layer below takes as `v_y`.
    pub gate: Option<&'a Buffer<f32>>,
}

/// Gradient to the input.
///
/// # Shapes
/// in `v_y` \[F,H,W,Co\] · `weight` · `gate` \[F,H,W,Ci\] · out `v_x` \[F,H,W,Ci\] (=)
/// # Equation: the adjoint of [`forward`] without its activation, padding included
/// # Determinism: bitwise; no atomics
/// # Cost
/// 54·F·H·W·Ci·Co operations and reads as [`forward`]'s, with Ci and Co exchanged.
///
/// # Errors
/// As [`forward`].
pub fn backward_input(
    rec: &mut Recorder,
    conv: &Conv3d,
    from: InputGradient<'_>,
    v_x: &mut Buffer<f32>,
    scratch: &mut Conv3dScratch,
) -> Result<(), KernelError> {
    conv.check()?;
    let InputGradient { v_y, weight, gate } = from;
    let pixels = conv.shape.pixels();
    expect_len(KERNEL, "v_y", v_y, pixels * conv.out_channels)?;
    expect_len(KERNEL, "weight", weight, conv.weight_len())?;
    expect_len(KERNEL, "gate", gate.unwrap_or(v_x), pixels * conv.in_channels)?;
    expect_len(KERNEL, "v_x", v_x, pixels * conv.in_channels)?;
    let weights = TAPS * conv.in_channels * conv.out_channels;
    expect_len(KERNEL, "scratch.weight_t", &scratch.weight_t, weights)?;
    let cooperation = conv.cooperation(rec)?;
    let params = conv3d_transpose::Params { in_channels: dim(conv.in_channels), out_channels: dim(conv.out_channels) };
    let bind = conv3d_transpose::Bind { weight, weight_t: &mut scratch.weight_t };
    rec.dispatch(bind, params, Grid::threads(weights / 4))?;
    let (depth4, width4) = (dim(conv.out_channels / 4), dim(conv.in_channels / 4));
    let block4 = block(width4, MAX_BLOCK4);
    let grid = conv.grid(rec.family(), width4 / block4);
    let (weight_t, gated) = (&scratch.weight_t, u32::from(gate.is_some()));
    let gate = gate.unwrap_or(v_y);
    /// As in [`forward`].
    macro_rules! adjoint {
        ($module:ident, $grid:expr, { $($size:ident),* }) => {{
            let (pad_t, pad_xy) = (conv.time.code(), conv.space.code());
            let spec = $module::Spec { depth4, width4, $($size,)* pad_t, pad_xy, gate: gated };
            let bind = $module::Bind { v_y, weight_t, gate, v_x };
            rec.dispatch_spec(bind, clip_params!($module, conv.shape), spec, $grid)
        }};
    }
    match (cooperation, rec.family()) {
        (Some(Cooperation { m: tm, n: tn, k: tk, subgroups, .. }), _) => {
            adjoint!(conv3d_bwd_coop, conv.coop_grid(width4), { tm, tn, tk, subgroups })
        }
        (None, KernelFamily::Lanes) => adjoint!(conv3d_bwd, grid, { block4 }),
        (None, KernelFamily::Tiles) => adjoint!(conv3d_bwd_tile, grid, { block4 }),
    }
}

/// Buffers of [`backward_weight`].
#[derive(Debug)]
pub struct WeightGradient<'a> {
    /// The layer's input `[F,H,W,Ci]`.
    pub x: &'a Buffer<f32>,
    /// `[F,H,W,Co]`, gradient before this layer's activation.
    pub v_y: &'a Buffer<f32>,
    /// In the layout of `weight`, bias included.
    pub v_weight: &'a mut Buffer<f32>,
    /// Whether `v_weight` is replaced or added to.
    pub accumulate: Accumulate,
}

/// Gradient to the weights and the bias.
///
/// # Shapes
/// in `x` \[F,H,W,Ci\] · `v_y` \[F,H,W,Co\] · out `v_weight` like `weight` (=) or (+=)
/// # Equation: Σ over pixels of v_y(o) · x(shifted by the tap, i)
/// # Determinism: bitwise; sums in a fixed order, no atomics
/// # Cost
/// 54·F·H·W·Ci·Co operations, and 216·Ci·Co bytes of partial sums per chunk written and read. Tiles read x 4.8·Co/16
/// times (three frames, a halo of 34×6 around 32×4 pixels) and `v_y` 3·Ci/4 times.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward_weight(
    rec: &mut Recorder,
    conv: &Conv3d,
    pass: WeightGradient<'_>,
    scratch: &mut Conv3dScratch,
) -> Result<(), KernelError> {
    conv.check()?;
    let WeightGradient { x, v_y, v_weight, accumulate } = pass;
    let pixels = conv.shape.pixels();
    expect_len(KERNEL, "x", x, pixels * conv.in_channels)?;
    expect_len(KERNEL, "v_y", v_y, pixels * conv.out_channels)?;
    expect_len(KERNEL, "v_weight", v_weight, conv.weight_len())?;
    let chunks = conv.chunks(rec.family());
    expect_len(KERNEL, "scratch.partial", &scratch.partial, chunks * conv.partial_texels() * 4)?;
    if pixels == 0 {
        if accumulate == Accumulate::Overwrite {
            rec.fill(v_weight, 0.0);
        }
        return Ok(());
    }
    match rec.family() {
        KernelFamily::Lanes => correlate_lanes(rec, conv, x, v_y, &mut scratch.partial)?,
        KernelFamily::Tiles => correlate_tiles(rec, conv, x, v_y, &mut scratch.partial)?,
    }
    let texels = v_weight.len() / 4;
    let params = conv3d_reduce::Params { texels: dim(texels), stride: dim(conv.partial_texels()), chunks: dim(chunks) };
    let spec = conv3d_reduce::Spec { accumulate: accumulate.flag() };
    let bind = conv3d_reduce::Bind { partial: &scratch.partial, v_weight };
    rec.dispatch_spec(bind, params, spec, Grid::threads(texels))
}

fn correlate_lanes(
    rec: &mut Recorder,
    conv: &Conv3d,
    x: &Buffer<f32>,
    v_y: &Buffer<f32>,
    partial: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let (in4, out4) = (dim(conv.in_channels / 4), dim(conv.out_channels / 4));
    let (in_block4, out_block4) = (block(in4, MAX_BLOCK4), block(out4, MAX_GRADIENT_BLOCK4));
    let spec = conv3d_correlate::Spec {
        in4,
        out4,
        in_block4,
        out_block4,
        pad_t: conv.time.code(),
        pad_xy: conv.space.code(),
        bias: u32::from(conv.bias == Bias::Added),
        unroll: UNROLL,
    };
    let params = clip_params!(conv3d_correlate, conv.shape, chunk_rows: conv.chunk_parts(KernelFamily::Lanes));
    let blocks = in4 / in_block4 * (out4 / out_block4);
    let grid = Grid::groups(dim(conv.chunks(KernelFamily::Lanes)), dim(TAPS), blocks);
    rec.dispatch_spec(conv3d_correlate::Bind { x, v_y, partial }, params, spec, grid)
}

fn correlate_tiles(
    rec: &mut Recorder,
    conv: &Conv3d,
    x: &Buffer<f32>,
    v_y: &Buffer<f32>,
    partial: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let (in4, out4) = (dim(conv.in_channels / 4), dim(conv.out_channels / 4));
    let out_block4 = block(out4, MAX_BLOCK4);
    let spec = conv3d_correlate_tile::Spec {
        in4,
        out4,
        out_block4,
        pad_t: conv.time.code(),
        pad_xy: conv.space.code(),
        bias: u32::from(conv.bias == Bias::Added),
    };
    let params = clip_params!(conv3d_correlate_tile, conv.shape, chunk_tiles: conv.chunk_parts(KernelFamily::Tiles));
    let grid = Grid::groups(dim(conv.chunks(KernelFamily::Tiles)), FRAME_TAPS, in4 * (out4 / out_block4));
    rec.dispatch_spec(conv3d_correlate_tile::Bind { x, v_y, partial }, params, spec, grid)
}
