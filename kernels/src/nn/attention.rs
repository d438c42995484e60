//! Multi-head attention without a score matrix in memory.

use super::check::{as_i32, as_u32, expect_len, expect_multiple, shape_error};
use super::pack::Precision;
use crate::error::KernelError;
use crate::registry::nn::{
    attention_delta, attention_fwd, attention_fwd_coop, attention_fwd_tile, attention_vkv, attention_vkv_coop,
    attention_vkv_tile, attention_vq, attention_vq_coop, attention_vq_tile,
};
use crate::vk::{Buffer, Cooperation, Device, Grid, KernelFamily, Recorder};

const KERNEL: &str = "nn/attention";
/// Queries or keys that one workgroup of the lane kernels computes: `TILE` of `glsl/lib/attention_tile.glsl`.
const LANE_ROWS: usize = 16;
/// The same of the tile kernels: `TILE` of `glsl/lib/attention_block.glsl`.
const TILE_ROWS: usize = 32;
/// The same of the kernels over cooperative matrices, of keys or queries at a time too: `TILE` of
/// `glsl/lib/attention_coop.glsl`.
const COOP_ROWS: u32 = 32;
/// Largest head of these: `MAX_DIM` there.
const COOP_HEAD_DIM: usize = 64;
/// Heads are padded to a multiple of this there.
const COOP_PART: u32 = 16;

/// Which keys a query sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mask {
    /// All.
    Full,
    /// Query i sees keys 0 ..= keys − queries + i.
    Causal,
}

/// Sizes of one attention layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttentionShape {
    /// Independent sequences.
    pub batch: usize,
    /// Heads.
    pub heads: usize,
    /// Elements of one head, a multiple of 4.
    pub head_dim: usize,
    /// Queries per sequence; with [`Projections::Fused`] equal to `keys`.
    pub queries: usize,
    /// Keys and values per sequence.
    pub keys: usize,
    /// Which keys a query sees.
    pub mask: Mask,
    /// With [`Precision::Half`] the products come from cooperative matrices: their factors, so also probabilities and
    /// their gradients, are rounded to 16-bit floats, gradients with a scale that they have in common, while sums and
    /// statistics are 32-bit floats. A causal mask, a head of more than 64 elements, and anything but `Half` is 32-bit
    /// floats throughout.
    pub precision: Precision,
}

impl AttentionShape {
    /// Elements of a token, all heads together.
    #[must_use]
    pub fn width(&self) -> usize {
        self.heads * self.head_dim
    }

    /// The device's cooperative matrices where this layer takes them: by its precision, where the kernels have its mask
    /// and head, and where the device's subgroups can share a workgroup's tile.
    fn cooperation(&self, rec: &Recorder) -> Result<Option<Cooperation>, KernelError> {
        if self.precision != Precision::Half {
            return Ok(None);
        }
        let matrices = rec.cooperation()?;
        let Cooperation { m, n, k, subgroups, .. } = matrices;
        let shared = COOP_ROWS.is_multiple_of(m)
            && COOP_PART.is_multiple_of(n)
            && COOP_PART.is_multiple_of(k)
            && (COOP_ROWS * COOP_ROWS).is_multiple_of(m * n * subgroups);
        let suits = self.mask == Mask::Full && self.head_dim <= COOP_HEAD_DIM;
        Ok((shared && suits).then_some(matrices))
    }

    fn spec_causal(&self) -> u32 {
        match self.mask {
            Mask::Full => 0,
            Mask::Causal => 1,
        }
    }
}

/// Queries, keys and values; a head is a slice of `head_dim` elements of each part.
#[derive(Clone, Copy, Debug)]
pub enum Projections<'a> {
    /// `[batch*keys, 3*width]`: q, k, v side by side.
    Fused(&'a Buffer<f32>),
    /// Queries of some tokens only.
    Split {
        /// `[batch*queries, width]`
        q: &'a Buffer<f32>,
        /// `[batch*keys, 2*width]`: k, v side by side.
        kv: &'a Buffer<f32>,
    },
}

/// Gradients of [`Projections`], laid out likewise.
#[derive(Debug)]
pub enum ProjectionGrads<'a> {
    /// `[batch*keys, 3*width]`
    Fused(&'a mut Buffer<f32>),
    /// See [`Projections::Split`].
    Split {
        /// `[batch*queries, width]`
        v_q: &'a mut Buffer<f32>,
        /// `[batch*keys, 2*width]`
        v_kv: &'a mut Buffer<f32>,
    },
}

/// Row statistics that the forward pass leaves for the backward pass.
#[derive(Debug)]
pub struct AttentionState {
    /// Base-2 logarithm of the softmax denominators `[batch, heads, queries]`.
    pub lse: Buffer<f32>,
    delta: Buffer<f32>,
}

impl AttentionState {
    /// Room for the statistics of one layer.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, name: &str, shape: &AttentionShape) -> Result<Self, KernelError> {
        let rows = shape.batch * shape.heads * shape.queries;
        let lse = device.buffer(&format!("{name}.lse"), rows)?;
        Ok(Self { lse, delta: device.buffer(&format!("{name}.delta"), rows)? })
    }
}

/// Strides and offsets of the two texel bindings.
struct Layout<'a> {
    q: &'a Buffer<f32>,
    kv: &'a Buffer<f32>,
    q_stride: usize,
    kv_stride: usize,
    k_offset: usize,
    v_offset: usize,
}

impl<'a> Layout<'a> {
    fn new(shape: &AttentionShape, inputs: Projections<'a>) -> Result<Self, KernelError> {
        expect_multiple(KERNEL, "head_dim", shape.head_dim, 4)?;
        let texels = shape.width() / 4;
        if shape.mask == Mask::Causal && shape.queries > shape.keys {
            let expected = format!("at most {} for a causal mask", shape.keys);
            return Err(shape_error(KERNEL, "queries", shape.queries.to_string(), expected));
        }
        match inputs {
            Projections::Fused(qkv) => {
                if shape.queries != shape.keys {
                    let expected = format!("{} as keys", shape.keys);
                    return Err(shape_error(KERNEL, "queries", shape.queries.to_string(), expected));
                }
                expect_len(
                    KERNEL,
                    "qkv",
                    qkv.len(),
                    shape.batch * shape.keys * 3 * shape.width(),
                    "batch*keys*3*width",
                )?;
                let stride = 3 * texels;
                Ok(Self {
                    q: qkv,
                    kv: qkv,
                    q_stride: stride,
                    kv_stride: stride,
                    k_offset: texels,
                    v_offset: 2 * texels,
                })
            }
            Projections::Split { q, kv } => {
                expect_len(KERNEL, "q", q.len(), shape.batch * shape.queries * shape.width(), "batch*queries*width")?;
                expect_len(KERNEL, "kv", kv.len(), shape.batch * shape.keys * 2 * shape.width(), "batch*keys*2*width")?;
                Ok(Self { q, kv, q_stride: texels, kv_stride: 2 * texels, k_offset: 0, v_offset: texels })
            }
        }
    }
}

/// Which program of a kernel runs.
#[derive(Clone, Copy)]
enum Program {
    Lanes,
    Tiles,
    Coop(Cooperation),
}

impl Program {
    fn of(rec: &Recorder, shape: &AttentionShape) -> Result<Self, KernelError> {
        Ok(match (shape.cooperation(rec)?, rec.family()) {
            (Some(matrices), _) => Self::Coop(matrices),
            (None, KernelFamily::Lanes) => Self::Lanes,
            (None, KernelFamily::Tiles) => Self::Tiles,
        })
    }

    /// Workgroups for these many queries or keys.
    fn grid(self, shape: &AttentionShape, rows: usize) -> Grid {
        let groups = match self {
            Self::Lanes => as_u32(rows.div_ceil(LANE_ROWS)),
            Self::Tiles => as_u32(rows.div_ceil(TILE_ROWS)),
            Self::Coop(_) => as_u32(rows).div_ceil(COOP_ROWS),
        };
        Grid::groups(groups, as_u32(shape.heads), as_u32(shape.batch))
    }
}

/// The programs of all three kernels share their sizes; only the module that the types come from differs, and what else
/// the constants are.
macro_rules! constants {
    ($module:ident, $shape:expr, $layout:expr, { $($size:ident: $value:expr),* }) => {{
        let (shape, layout): (&AttentionShape, &Layout) = ($shape, $layout);
        let spec = $module::Spec { head_dim: as_i32(shape.head_dim), $($size: $value),* };
        let params = $module::Params {
            queries: as_i32(shape.queries),
            keys: as_i32(shape.keys),
            q_stride: as_i32(layout.q_stride),
            kv_stride: as_i32(layout.kv_stride),
            k_offset: as_i32(layout.k_offset),
            v_offset: as_i32(layout.v_offset),
            scale: head_scale(shape.head_dim),
        };
        (spec, params)
    }};
}

/// As [`constants`] for a program of a kernel family.
macro_rules! family_constants {
    ($module:ident, $shape:expr, $layout:expr) => {
        constants!($module, $shape, $layout, { causal: $shape.spec_causal() })
    };
}

/// As [`constants`] for a program over cooperative matrices.
macro_rules! coop_constants {
    ($module:ident, $shape:expr, $layout:expr, $matrices:expr) => {{
        let Cooperation { m, n, k, subgroups, .. } = $matrices;
        constants!($module, $shape, $layout, { tm: m, tn: n, tk: k, subgroups: subgroups })
    }};
}

/// 1/√head_dim.
#[allow(clippy::cast_precision_loss, reason = "head sizes are far below 2^24")]
fn head_scale(head_dim: usize) -> f32 {
    1.0 / (head_dim as f32).sqrt()
}

/// `attn = softmax(Q Kᵀ / √head_dim) V` per head.
///
/// # Shapes
/// in `inputs`, see [`Projections`] · out `attn` \[batch*queries, width\] (=) · `state.lse` \[batch, heads, queries\]
/// (=)
/// # Equation: Vaswani et al. 2017, eq. 1; running maximum after Milakov & Gimelshein 2018
/// # Determinism: bitwise; no atomics
/// # Cost
/// 4·batch·queries·keys·width operations; a tile of r queries reads all keys and values, so
/// 8·batch·keys·width·queries/r bytes of memory or cache, r = 16 for lanes and 32 for tiles and cooperative matrices.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded; [`KernelError::Unsuitable`] for 16-bit floats on a device
/// without cooperative matrices.
pub fn forward(
    rec: &mut Recorder,
    shape: &AttentionShape,
    inputs: Projections,
    state: &mut AttentionState,
    attn: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let layout = Layout::new(shape, inputs)?;
    expect_len(KERNEL, "attn", attn.len(), shape.batch * shape.queries * shape.width(), "batch*queries*width")?;
    expect_len(KERNEL, "lse", state.lse.len(), shape.batch * shape.heads * shape.queries, "batch*heads*queries")?;
    if shape.keys == 0 {
        return Ok(());
    }
    let program = Program::of(rec, shape)?;
    let grid = program.grid(shape, shape.queries);
    let (q, kv, lse) = (layout.q, layout.kv, &mut state.lse);
    match program {
        Program::Lanes => {
            let (spec, params) = family_constants!(attention_fwd, shape, &layout);
            rec.dispatch_spec(attention_fwd::Bind { q_tex: q, kv_tex: kv, attn, lse }, params, spec, grid)
        }
        Program::Tiles => {
            let (spec, params) = family_constants!(attention_fwd_tile, shape, &layout);
            rec.dispatch_spec(attention_fwd_tile::Bind { q, kv, attn, lse }, params, spec, grid)
        }
        Program::Coop(matrices) => {
            let (spec, params) = coop_constants!(attention_fwd_coop, shape, &layout, matrices);
            rec.dispatch_spec(attention_fwd_coop::Bind { q, kv, attn, lse }, params, spec, grid)
        }
    }
}

/// What the backward pass reads.
#[derive(Clone, Copy, Debug)]
pub struct Upstream<'a> {
    /// Inputs of the forward pass.
    pub inputs: Projections<'a>,
    /// Output of the forward pass `[batch*queries, width]`.
    pub attn: &'a Buffer<f32>,
    /// Its gradient.
    pub v_attn: &'a Buffer<f32>,
}

/// Gradients to queries, keys and values; probabilities are recomputed from `state.lse`.
///
/// # Shapes
/// in [`Upstream`] · `state` of the forward pass · out `grads` (=), see [`ProjectionGrads`]
/// # Equation: Dao et al. 2022, algorithm 4
/// # Determinism: bitwise; no atomics
/// # Cost
/// 14·batch·queries·keys·width operations: each of both passes computes the scores again.
///
/// # Errors
/// As [`forward`].
pub fn backward(
    rec: &mut Recorder,
    shape: &AttentionShape,
    upstream: &Upstream,
    state: &mut AttentionState,
    grads: ProjectionGrads,
) -> Result<(), KernelError> {
    let layout = Layout::new(shape, upstream.inputs)?;
    let tokens = shape.batch * shape.queries;
    expect_len(KERNEL, "attn", upstream.attn.len(), tokens * shape.width(), "batch*queries*width")?;
    expect_len(KERNEL, "v_attn", upstream.v_attn.len(), tokens * shape.width(), "batch*queries*width")?;
    expect_len(KERNEL, "lse", state.lse.len(), tokens * shape.heads, "batch*heads*queries")?;
    check_grads(&layout, &grads)?;
    if shape.keys * shape.queries == 0 {
        return Ok(());
    }
    shape.cooperation(rec)?;
    delta(rec, shape, upstream, state)?;
    match grads {
        ProjectionGrads::Fused(v_qkv) => {
            v_q(rec, shape, &layout, upstream.v_attn, state, v_qkv)?;
            v_kv(rec, shape, &layout, upstream.v_attn, state, v_qkv)
        }
        ProjectionGrads::Split { v_q: out_q, v_kv: out_kv } => {
            v_q(rec, shape, &layout, upstream.v_attn, state, out_q)?;
            v_kv(rec, shape, &layout, upstream.v_attn, state, out_kv)
        }
    }
}

fn check_grads(layout: &Layout, grads: &ProjectionGrads) -> Result<(), KernelError> {
    let (got_q, got_kv) = match grads {
        ProjectionGrads::Fused(v_qkv) => (v_qkv.len(), v_qkv.len()),
        ProjectionGrads::Split { v_q, v_kv } => (v_q.len(), v_kv.len()),
    };
    expect_len(KERNEL, "v_q", got_q, layout.q.len(), "like q")?;
    expect_len(KERNEL, "v_kv", got_kv, layout.kv.len(), "like kv")
}

fn delta(
    rec: &mut Recorder,
    shape: &AttentionShape,
    upstream: &Upstream,
    state: &mut AttentionState,
) -> Result<(), KernelError> {
    let total = shape.batch * shape.queries * shape.heads;
    let params =
        attention_delta::Params { total: as_u32(total), heads: as_u32(shape.heads), queries: as_u32(shape.queries) };
    let spec = attention_delta::Spec { head_dim: as_i32(shape.head_dim) };
    let bind = attention_delta::Bind { attn_tex: upstream.attn, v_attn_tex: upstream.v_attn, delta: &mut state.delta };
    rec.dispatch_spec(bind, params, spec, Grid::threads(total))
}

fn v_q(
    rec: &mut Recorder,
    shape: &AttentionShape,
    layout: &Layout,
    v_attn: &Buffer<f32>,
    state: &AttentionState,
    v_q: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let program = Program::of(rec, shape)?;
    let grid = program.grid(shape, shape.queries);
    let (q, kv, lse, delta) = (layout.q, layout.kv, &state.lse, &state.delta);
    match program {
        Program::Lanes => {
            let (spec, params) = family_constants!(attention_vq, shape, layout);
            let bind = attention_vq::Bind { q_tex: q, kv_tex: kv, v_attn_tex: v_attn, lse, delta, v_q };
            rec.dispatch_spec(bind, params, spec, grid)
        }
        Program::Tiles => {
            let (spec, params) = family_constants!(attention_vq_tile, shape, layout);
            rec.dispatch_spec(attention_vq_tile::Bind { q, kv, v_attn, lse, delta, v_q }, params, spec, grid)
        }
        Program::Coop(matrices) => {
            let (spec, params) = coop_constants!(attention_vq_coop, shape, layout, matrices);
            rec.dispatch_spec(attention_vq_coop::Bind { q, kv, v_attn, lse, delta, v_q }, params, spec, grid)
        }
    }
}

fn v_kv(
    rec: &mut Recorder,
    shape: &AttentionShape,
    layout: &Layout,
    v_attn: &Buffer<f32>,
    state: &AttentionState,
    v_kv: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let program = Program::of(rec, shape)?;
    let grid = program.grid(shape, shape.keys);
    let (q, kv, lse, delta) = (layout.q, layout.kv, &state.lse, &state.delta);
    match program {
        Program::Lanes => {
            let (spec, params) = family_constants!(attention_vkv, shape, layout);
            let bind = attention_vkv::Bind { q_tex: q, kv_tex: kv, v_attn_tex: v_attn, lse, delta, v_kv };
            rec.dispatch_spec(bind, params, spec, grid)
        }
        Program::Tiles => {
            let (spec, params) = family_constants!(attention_vkv_tile, shape, layout);
            rec.dispatch_spec(attention_vkv_tile::Bind { q, kv, v_attn, lse, delta, v_kv }, params, spec, grid)
        }
        Program::Coop(matrices) => {
            let (spec, params) = coop_constants!(attention_vkv_coop, shape, layout, matrices);
            rec.dispatch_spec(attention_vkv_coop::Bind { q, kv, v_attn, lse, delta, v_kv }, params, spec, grid)
        }
    }
}
