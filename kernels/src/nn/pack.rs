//! The right operand of a matrix product, in the order in which subgroup lanes fetch it.

use std::str::FromStr;

use super::check::{as_u32, expect_len, expect_multiple, shape_error};
use crate::error::KernelError;
use crate::registry::nn::pack_gather;
use crate::vk::{Buffer, Device, Grid, Recorder};

const KERNEL: &str = "nn/pack";
/// Columns of C that one fetch serves: the lanes of a subgroup.
pub const LANES: usize = 8;
/// Consecutive k of one fetch: a texel.
pub const TEXEL: usize = 4;

/// Largest 16-bit code.
const MAX_CODE: f32 = 32_767.0;

/// How the elements of a weight are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit floats.
    #[default]
    F32,
    /// Whole numbers from -32767 to 32767, times a float per row of W: an element is off by at most 2⁻¹⁶ of the largest
    /// one of its row. Half the memory, and half the fetches of a product.
    Fixed16,
    /// 16-bit floats, and the left operand of a product is rounded to such too, for the cooperative matrices of a GPU:
    /// a factor is off by at most 2⁻¹¹ of itself, and infinite beyond 65,504. Gradients are brought near 1 before they
    /// are rounded. Sums are 32-bit floats.
    Half,
}

impl Precision {
    /// Name on the command line and in receipts.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Fixed16 => "fixed16",
            Self::Half => "f16",
        }
    }
}

impl FromStr for Precision {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let all = [Self::F32, Self::Fixed16, Self::Half];
        all.into_iter()
            .find(|p| p.name() == text)
            .ok_or_else(|| format!("`{text}`: expected {}", all.map(Self::name).join(" or ")))
    }
}

impl std::fmt::Display for Precision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A matrix W `[n, k]` (a `PyTorch` Linear weight: outputs, inputs) packed as `[n/8][k/4][8 lanes]` vec4.
/// `n` is padded to a multiple of 8 and `k` to a multiple of 4 with zeros.
#[derive(Debug)]
pub struct PackedWeight {
    pub(crate) elements: Elements,
    pub(crate) no_bias: Buffer<f32>,
    pub(crate) left: Left,
    n: usize,
    k: usize,
}

/// What a weight is multiplied with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Left {
    /// Values, which 16-bit floats hold as they are.
    Values,
    /// Gradients, which may be smaller than any 16-bit float: these are rounded with a common scale.
    Gradients,
}

/// The elements of W on the device.
#[derive(Debug)]
pub(crate) enum Elements {
    /// `[n/8][k/4][8 lanes]` vec4
    F32(Buffer<f32>),
    /// `codes` `[n/16][k/4][8 lanes]` uvec4, an even lane-block in the low halves and the next one in the high halves,
    /// times `scale` `[n]`
    Fixed16 { codes: Buffer<u32>, scale: Buffer<f32> },
    /// `[n/8][k/4][8 lanes]` uvec2 of four 16-bit floats
    Half(Buffer<u32>),
}

/// How W lies in a plain buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// `src[i * stride + j]` is W(i, j): rows of W are contiguous.
    Rows {
        /// Elements from one row to the next.
        stride: usize,
    },
    /// `src[j * stride + i]` is W(i, j): the buffer holds Wᵀ.
    Columns {
        /// Elements from one column to the next.
        stride: usize,
    },
}

impl PackedWeight {
    /// Packs `w` `[n, k]` on the host.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when `w` is not `n * k` long; [`KernelError::Allocation`] when memory runs out.
    pub fn new(device: &Device, name: &str, w: &[f32], n: usize, k: usize) -> Result<Self, KernelError> {
        Self::in_precision(device, name, w, n, k, Precision::F32)
    }

    /// Packs `w` `[n, k]` on the host in the given precision.
    ///
    /// # Errors
    /// As [`PackedWeight::new`]; [`KernelError::Shape`] too when `n` is not a multiple of 16 for 16-bit codes;
    /// [`KernelError::Unsuitable`] for 16-bit floats on a device without cooperative matrices.
    pub fn in_precision(
        device: &Device,
        name: &str,
        w: &[f32],
        n: usize,
        k: usize,
        precision: Precision,
    ) -> Result<Self, KernelError> {
        expect_len(KERNEL, "w", w.len(), n * k, "n*k")?;
        let elements = match precision {
            Precision::F32 => Elements::F32(device.buffer_from(name, &packed_order(w, n, k))?),
            Precision::Fixed16 => coded(device, name, w, n, k)?,
            Precision::Half => {
                device.cooperation()?;
                let packed = packed_order(w, n, k);
                let pairs: Vec<u32> = packed.as_chunks().0.iter().map(|[low, high]| half_pair(*low, *high)).collect();
                Elements::Half(device.buffer_from(name, &pairs)?)
            }
        };
        Self::of(device, name, elements, n, k)
    }

    fn of(device: &Device, name: &str, elements: Elements, n: usize, k: usize) -> Result<Self, KernelError> {
        let no_bias = device.buffer(&format!("{name}.no_bias"), n.next_multiple_of(LANES))?;
        Ok(Self { elements, no_bias, left: Left::Values, n, k })
    }

    /// Packs the transpose of `w` `[k, n]` on the host: the operand of the gradient to the input.
    ///
    /// # Errors
    /// As [`PackedWeight::in_precision`].
    pub fn transposed(
        device: &Device,
        name: &str,
        w: &[f32],
        n: usize,
        k: usize,
        precision: Precision,
    ) -> Result<Self, KernelError> {
        expect_len(KERNEL, "w", w.len(), n * k, "k*n")?;
        let columns: Vec<f32> = (0..n * k).map(|i| w[(i % k) * n + i / k]).collect();
        Ok(Self { left: Left::Gradients, ..Self::in_precision(device, name, &columns, n, k, precision)? })
    }

    /// The matrix in its packed order; `None` where it is not kept as floats.
    #[must_use]
    pub fn packed(&self) -> Option<&Buffer<f32>> {
        match &self.elements {
            Elements::F32(packed) => Some(packed),
            Elements::Fixed16 { .. } | Elements::Half(_) => None,
        }
    }

    /// How the elements are kept.
    #[must_use]
    pub fn precision(&self) -> Precision {
        match self.elements {
            Elements::F32(_) => Precision::F32,
            Elements::Fixed16 { .. } => Precision::Fixed16,
            Elements::Half(_) => Precision::Half,
        }
    }

    /// A zero matrix, to be filled by [`gather`].
    ///
    /// # Errors
    /// [`KernelError::Allocation`] when memory runs out.
    pub fn zeros(device: &Device, name: &str, n: usize, k: usize) -> Result<Self, KernelError> {
        let packed = device.buffer(name, n.next_multiple_of(LANES) * k.next_multiple_of(TEXEL))?;
        Self::of(device, name, Elements::F32(packed), n, k)
    }

    /// Columns of C, padding included: the row stride of a product with this weight.
    #[must_use]
    pub fn n(&self) -> usize {
        self.n.next_multiple_of(LANES)
    }

    /// Columns of A, padding included: the row stride of its left operand.
    #[must_use]
    pub fn k(&self) -> usize {
        self.k.next_multiple_of(TEXEL)
    }
}

/// `w` `[n, k]` in lane order, zero-padded.
fn packed_order(w: &[f32], n: usize, k: usize) -> Vec<f32> {
    let texels = k.div_ceil(TEXEL);
    let mut packed = vec![0.0; n.next_multiple_of(LANES) * texels * TEXEL];
    for (row, values) in w.chunks_exact(k.max(1)).enumerate() {
        let block = (row / LANES) * texels;
        for (col, value) in values.iter().enumerate() {
            packed[((block + col / TEXEL) * LANES + row % LANES) * TEXEL + col % TEXEL] = *value;
        }
    }
    packed
}

/// `w` in 16-bit codes with a scale per row.
fn coded(device: &Device, name: &str, w: &[f32], n: usize, k: usize) -> Result<Elements, KernelError> {
    expect_multiple(KERNEL, "n", n, 2 * LANES)?;
    let scale: Vec<f32> = w.chunks_exact(k.max(1)).map(code_unit).collect();
    let codes = |(row, unit): (&[f32], &f32)| row.iter().map(|v| v / unit).collect::<Vec<_>>();
    let codes: Vec<f32> = w.chunks_exact(k.max(1)).zip(&scale).flat_map(codes).collect();
    let codes = device.buffer_from(name, &paired(&packed_order(&codes, n, k), k))?;
    let scale = device.buffer_from(&format!("{name}.scale"), &scale)?;
    Ok(Elements::Fixed16 { codes, scale })
}

/// Two values as 16-bit floats, the first in the low half.
fn half_pair(low: f32, high: f32) -> u32 {
    let bits = |v: f32| u32::from(half::f16::from_f32(v).to_bits());
    bits(low) | bits(high) << 16
}

/// Float that one code of a row stands for; NaN or infinite where an element is, so that the row's products are too.
fn code_unit(row: &[f32]) -> f32 {
    match row.iter().map(|v| v.abs()).fold(0.0, f32::max) {
        _ if row.iter().any(|v| v.is_nan()) => f32::NAN,
        0.0 => 1.0,
        largest => largest / MAX_CODE,
    }
}

#[allow(clippy::cast_possible_truncation, reason = "it saturates, and a NaN becomes 0: its row's scale is NaN")]
fn code(value: f32) -> u32 {
    u32::from((value.round() as i16).cast_unsigned())
}

/// Rounds packed values to 16 bits; the lane-blocks of eight rows meet in pairs.
fn paired(packed: &[f32], k: usize) -> Vec<u32> {
    let block = k.div_ceil(TEXEL) * LANES * TEXEL;
    let pair = |two: &[f32]| {
        two[..block].iter().zip(&two[block..]).map(|(l, h)| code(*l) | code(*h) << 16).collect::<Vec<_>>()
    };
    packed.chunks_exact((2 * block).max(1)).flat_map(pair).collect()
}

/// Packs a matrix that lies on the device, whole or as the top left part of a wider buffer.
///
/// # Shapes
/// in `src` per `order`; the size of W is that of `out` before padding · out `out` (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn gather(rec: &mut Recorder, src: &Buffer<f32>, order: Order, out: &mut PackedWeight) -> Result<(), KernelError> {
    let (n, k, precision) = (out.n, out.k, out.precision());
    let Elements::F32(packed) = &mut out.elements else {
        return Err(shape_error(KERNEL, "out", precision.to_string(), Precision::F32.to_string()));
    };
    let (stride_n, stride_k) = match order {
        Order::Rows { stride } => (stride, 1),
        Order::Columns { stride } => (1, stride),
    };
    let needed = if n * k == 0 { 0 } else { (n - 1) * stride_n + (k - 1) * stride_k + 1 };
    if src.len() < needed {
        return Err(shape_error(
            KERNEL,
            "src",
            format!("[{}]", src.len()),
            format!("at least [{needed}] for {order:?}"),
        ));
    }
    let total = packed.len() / TEXEL;
    let params = pack_gather::Params {
        n: as_u32(n),
        k: as_u32(k),
        stride_n: as_u32(stride_n),
        stride_k: as_u32(stride_k),
        total: as_u32(total),
    };
    rec.dispatch(pack_gather::Bind { src, packed }, params, Grid::threads(total))
}
