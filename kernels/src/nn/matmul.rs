//! Matrix product with a packed right operand.

use super::activation::Activation;
use super::check::{as_i32, as_u32, expect_len, expect_multiple, shape_error};
use super::pack::{Elements, LANES, Left, Order, PackedWeight, Precision, TEXEL, gather};
use super::transpose;
use crate::error::KernelError;
use crate::registry::nn::{
    matmul_fwd, matmul_fwd_coop, matmul_fwd_fixed16, matmul_fwd_fixed16_tile, matmul_fwd_tile, matmul_fwd_windows,
    matmul_fwd_windows_tile, matmul_gradient_tile,
};
use crate::shape::require_len;
use crate::vk::{Buffer, COOP_TILE, Cooperation, Device, Grid, KernelFamily, Recorder};

const KERNEL: &str = "nn/matmul";
/// Rows of C that one workgroup computes: `TILE_ROWS` of `glsl/lib/gemm_tile.glsl`.
const TILE_ROWS: usize = 16;
/// Lane-blocks per tile, best first: the widest loop that a processor's cache of decoded instructions still holds.
const BLOCKS: [usize; 5] = [8, 6, 4, 2, 1];
/// Columns of C that one workgroup of the tile kernels computes.
const TILE_COLUMNS: usize = 64;
/// Invocations of such a workgroup along its rows.
const TILE_ROW_THREADS: usize = 8;
/// Rows of one invocation: the fewer loads per product, or twice as many workgroups.
const ROWS_PER_THREAD: [usize; 2] = [8, 4];
/// Workgroups that keep a large GPU busy; a product with fewer of them gets the smaller tiles.
const WANTED_GROUPS: usize = 256;

/// What happens to s = A Wᵀ + bias before it is stored.
#[derive(Clone, Copy, Debug)]
pub enum Epilogue<'a> {
    /// act(s)
    Activate(Activation),
    /// s + residual, `[m, n]` or longer
    Add(&'a Buffer<f32>),
    /// s act'(pre), `[m, n]` or longer: the gradient through an activation whose input was `pre`
    Grad(Activation, &'a Buffer<f32>),
}

/// The operands of one product.
#[derive(Clone, Copy, Debug)]
pub struct Product<'a> {
    /// Left operand A `[rows, weight.k()]`, row-major.
    pub a: &'a Buffer<f32>,
    /// Rows of A and C.
    pub rows: usize,
    /// Right operand W.
    pub weight: &'a PackedWeight,
    /// Added to every row, `[weight.n()]`.
    pub bias: Option<&'a Buffer<f32>>,
    /// Applied before the store.
    pub epilogue: Epilogue<'a>,
}

impl<'a> Product<'a> {
    /// A Wᵀ without bias or epilogue.
    #[must_use]
    pub fn plain(a: &'a Buffer<f32>, rows: usize, weight: &'a PackedWeight) -> Self {
        Self { a, rows, weight, bias: None, epilogue: Epilogue::Activate(Activation::Identity) }
    }
}

/// `C = epilogue(A Wᵀ + bias)`.
///
/// # Shapes
/// in `a` \[rows, k\] · `weight` \[n, k\] packed · `bias` \[n\] · residual or pre-activation \[rows, n\] · out `c`
/// \[rows, n\] (=); n and k are the padded sizes of [`PackedWeight`]
/// # Equation: s = A Wᵀ + bias, then [`Epilogue`]
/// # Determinism: bitwise; every element is one sum in the order of k, with 16-bit floats in one that the device fixes
/// # Cost
/// 2·rows·n·k operations. Lanes load (1/48 + 1/16) texels per four products. Tiles of r×64 read 4·rows·n·k·(1/64 + 1/r)
/// bytes of memory or cache, r = 64 or 32, and 16/r + 1/4 texels of shared memory per 32 products of an invocation.
/// Cooperative matrices read rows·n·k·(4/64 + 2/64) bytes.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, product: &Product, c: &mut Buffer<f32>) -> Result<(), KernelError> {
    expect_len(KERNEL, "a", product.a.len(), product.rows * product.weight.k(), "rows*k")?;
    multiply(rec, product, None, c)
}

/// Square windows of images `[F, height, width, channels]`, as `glsl/lib/windows.glsl` has them: the rows of a left
/// operand that is never written out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Windows {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) out_height: usize,
    pub(super) out_width: usize,
    /// A multiple of 4.
    pub(super) channels: usize,
    /// Side of a window.
    pub(super) taps: usize,
    /// Zeros around an image.
    pub(super) padding: usize,
}

/// [`forward`] with the windows of `product.a` as left operand; whether `a` holds that many is for the caller to check.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded, also for a weight that is not kept in 32-bit floats.
pub(super) fn of_windows(
    rec: &mut Recorder,
    product: &Product,
    windows: Windows,
    c: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    multiply(rec, product, Some(windows), c)
}

/// Checks everything but the left operand, and runs the product.
fn multiply(
    rec: &mut Recorder,
    product: &Product,
    windows: Option<Windows>,
    c: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let Product { a, rows, weight, bias, epilogue } = *product;
    let (n, k) = (weight.n(), weight.k());
    expect_len(KERNEL, "c", c.len(), rows * n, "rows*n")?;
    let bias = bias.unwrap_or(&weight.no_bias);
    expect_len(KERNEL, "bias", bias.len(), n, "n")?;
    let (mode, activation, aux) = match epilogue {
        Epilogue::Activate(activation) => (0, activation, bias),
        Epilogue::Add(residual) => (1, Activation::Identity, residual),
        Epilogue::Grad(activation, pre) => (2, activation, pre),
    };
    if mode > 0 {
        require_len(KERNEL, "aux", aux.len(), rows * n)?;
    }
    if rows * n * k == 0 {
        rec.fill(c, 0.0);
        return Ok(());
    }
    let operands = Operands { a, rows, weight, bias, aux, mode, activation: activation.code() };
    match windows {
        None => dispatch(rec, &operands, c),
        Some(windows) => dispatch_windows(rec, &operands, windows, c),
    }
}

/// A product whose lengths are checked; `mode` and `activation` are the shaders' constants of the epilogue.
struct Operands<'a> {
    a: &'a Buffer<f32>,
    rows: usize,
    weight: &'a PackedWeight,
    bias: &'a Buffer<f32>,
    aux: &'a Buffer<f32>,
    mode: u32,
    activation: u32,
}

/// Runs the program for the device's family and the weight's precision.
fn dispatch(rec: &mut Recorder, operands: &Operands, c: &mut Buffer<f32>) -> Result<(), KernelError> {
    let Operands { a, rows, weight, bias, aux, mode, activation } = *operands;
    let (n, k) = (weight.n(), weight.k());
    /// Binds and runs one program; they differ in how they cut C and in what they call their operands.
    macro_rules! multiply {
        ($module:ident, $grid:expr, { $($size:ident: $value:expr),* }, { $($operand:ident: $buffer:expr),* }) => {{
            let spec = $module::Spec { mode, activation, $($size: $value),* };
            let params = $module::Params { m: as_i32(rows), n: as_i32(n), k: as_i32(k) };
            rec.dispatch_spec($module::Bind { bias, c, $($operand: $buffer),* }, params, spec, $grid)
        }};
    }
    let (blocks, lane_grid) = lane_tiling(rows, n);
    let (per_thread, tile_grid) = tiling(rows, n);
    match (&weight.elements, rec.family()) {
        (Elements::F32(w), KernelFamily::Lanes) => {
            multiply!(matmul_fwd, lane_grid, { blocks: blocks }, { a_tex: a, w_tex: w, aux_tex: aux })
        }
        (Elements::F32(w), KernelFamily::Tiles) => {
            multiply!(matmul_fwd_tile, tile_grid, { rows: per_thread }, { a: a, w: w, aux: aux })
        }
        (Elements::Fixed16 { codes: w, scale }, KernelFamily::Lanes) => {
            let grid = lane_grid;
            multiply!(matmul_fwd_fixed16, grid, { blocks: blocks }, { a_tex: a, w_tex: w, aux_tex: aux, scale: scale })
        }
        (Elements::Fixed16 { codes: w, scale }, KernelFamily::Tiles) => {
            multiply!(matmul_fwd_fixed16_tile, tile_grid, { rows: per_thread }, { a: a, w: w, aux: aux, scale: scale })
        }
        (Elements::Half(w), _) => {
            let Cooperation { m: tm, n: tn, k: tk, subgroups, row_blocks } = rec.cooperation()?;
            let grid = Grid::groups(as_u32(rows).div_ceil(COOP_TILE), as_u32(n).div_ceil(COOP_TILE), 1);
            let bind = matmul_fwd_coop::Bind { a, w, bias, aux, c };
            let scaled = u32::from(weight.left == Left::Gradients);
            let spec = matmul_fwd_coop::Spec { tm, tn, tk, subgroups, row_blocks, mode, activation, scaled };
            let params = matmul_fwd_coop::Params { m: as_i32(rows), n: as_i32(n), k: as_i32(k) };
            rec.dispatch_spec(bind, params, spec, grid)
        }
    }
}

/// The same for the windows of images, with weights in 32-bit floats.
fn dispatch_windows(
    rec: &mut Recorder,
    operands: &Operands,
    windows: Windows,
    c: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let Operands { a, rows, weight, bias, aux, mode, activation } = *operands;
    let (n, k) = (weight.n(), weight.k());
    let Elements::F32(w) = &weight.elements else {
        return Err(shape_error(KERNEL, "weight", weight.precision().to_string(), Precision::F32.to_string()));
    };
    macro_rules! params {
        ($module:ident) => {
            $module::Params {
                m: as_i32(rows),
                n: as_i32(n),
                k: as_i32(k),
                height: as_i32(windows.height),
                width: as_i32(windows.width),
                out_height: as_i32(windows.out_height),
                out_width: as_i32(windows.out_width),
                channels4: as_i32(windows.channels / TEXEL),
                taps: as_i32(windows.taps),
                padding: as_i32(windows.padding),
            }
        };
    }
    match rec.family() {
        KernelFamily::Lanes => {
            let (blocks, grid) = lane_tiling(rows, n);
            let bind = matmul_fwd_windows::Bind { a_tex: a, w_tex: w, bias, aux_tex: aux, c };
            let spec = matmul_fwd_windows::Spec { blocks, mode, activation };
            rec.dispatch_spec(bind, params!(matmul_fwd_windows), spec, grid)
        }
        KernelFamily::Tiles => {
            let (per_thread, grid) = tiling(rows, n);
            let bind = matmul_fwd_windows_tile::Bind { a, w, bias, aux, c };
            let spec = matmul_fwd_windows_tile::Spec { rows: per_thread, mode, activation };
            rec.dispatch_spec(bind, params!(matmul_fwd_windows_tile), spec, grid)
        }
    }
}

/// Lane-blocks of a tile of the lane kernels, and the workgroups that cover C.
fn lane_tiling(rows: usize, n: usize) -> (i32, Grid) {
    let blocks = BLOCKS.into_iter().find(|b| (n / LANES).is_multiple_of(*b)).unwrap_or(1);
    (as_i32(blocks), Grid::groups(as_u32(rows.div_ceil(TILE_ROWS)), as_u32(n / LANES / blocks), 1))
}

/// Rows per invocation of the tile kernels for a result `[rows, columns]`, and the workgroups that cover it.
fn tiling(rows: usize, columns: usize) -> (i32, Grid) {
    let across = columns.div_ceil(TILE_COLUMNS);
    let down = |per_thread: usize| rows.div_ceil(TILE_ROW_THREADS * per_thread);
    let [large, small] = ROWS_PER_THREAD;
    let per_thread = if down(large) * across >= WANTED_GROUPS { large } else { small };
    (as_i32(per_thread), Grid::groups(as_u32(down(per_thread)), as_u32(across), 1))
}

/// Operands of [`weight_gradient`] in the order that the lane kernels want them; the tile kernels take them as they
/// are.
#[derive(Debug)]
struct Rearranged {
    v_c_t: Buffer<f32>,
    a_t: PackedWeight,
}

/// Working memory of [`weight_gradient`].
#[derive(Debug)]
pub struct GradScratch {
    lanes: Option<Rearranged>,
    rows: usize,
    n: usize,
    k: usize,
}

impl GradScratch {
    /// Room for the weight gradient of a product of `rows` rows with a weight `[n, k]`.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when `n` or `k` is not a multiple of 8; [`KernelError::Allocation`] when memory runs out.
    pub fn new(device: &Device, name: &str, rows: usize, n: usize, k: usize) -> Result<Self, KernelError> {
        expect_multiple(KERNEL, "n", n, LANES)?;
        expect_multiple(KERNEL, "k", k, LANES)?;
        let lanes = match device.family() {
            KernelFamily::Lanes => Some(Rearranged {
                v_c_t: device.buffer(&format!("{name}.v_c_t"), n * rows.next_multiple_of(TEXEL))?,
                a_t: PackedWeight::zeros(device, &format!("{name}.a_t"), k, rows)?,
            }),
            KernelFamily::Tiles => None,
        };
        Ok(Self { lanes, rows, n, k })
    }
}

/// Gradient of A Wᵀ to the weight: `v_w = v_cᵀ A`.
///
/// # Shapes
/// in `a` \[rows, k\] · `v_c` \[rows, n\] · out `v_w` \[n, k\] row-major (=)
/// # Determinism: bitwise; every element is one sum in the order of rows
/// # Cost
/// 2·rows·n·k operations. Lanes first move 16·rows·(n + k) bytes into their order; tiles read both operands as they
/// are.
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn weight_gradient(
    rec: &mut Recorder,
    a: &Buffer<f32>,
    v_c: &Buffer<f32>,
    scratch: &mut GradScratch,
    v_w: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let (rows, n, k) = (scratch.rows, scratch.n, scratch.k);
    expect_len(KERNEL, "a", a.len(), rows * k, "rows*k")?;
    expect_len(KERNEL, "v_c", v_c.len(), rows * n, "rows*n")?;
    expect_len(KERNEL, "v_w", v_w.len(), n * k, "n*k")?;
    if let Some(Rearranged { v_c_t, a_t }) = &mut scratch.lanes {
        transpose::copy(rec, v_c, rows, n, v_c_t)?;
        gather(rec, a, Order::Columns { stride: k }, a_t)?;
        return forward(rec, &Product::plain(v_c_t, n, a_t), v_w);
    }
    if rows == 0 {
        rec.fill(v_w, 0.0);
        return Ok(());
    }
    let (per_thread, grid) = tiling(n, k);
    let spec = matmul_gradient_tile::Spec { rows: per_thread };
    let params = matmul_gradient_tile::Params { m: as_i32(rows), n: as_i32(n), k: as_i32(k) };
    rec.dispatch_spec(matmul_gradient_tile::Bind { v_c, a, v_w }, params, spec, grid)
}
