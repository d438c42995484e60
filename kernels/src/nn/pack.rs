//! The right operand of a matrix product, in the order in which subgroup lanes fetch it.

use super::{as_u32, expect_len, shape_error};
use crate::registry::nn::pack_gather;
use crate::{Buffer, Device, Grid, KernelError, Precision, Recorder};

const KERNEL: &str = "nn/pack";
/// Columns of C that one fetch serves: the lanes of a subgroup.
pub const LANES: usize = 8;
/// Consecutive k of one fetch: a texel.
pub const TEXEL: usize = 4;

/// A matrix W `[n, k]` (a `PyTorch` Linear weight: outputs, inputs) packed as `[n/8][k/4][8 lanes]` vec4.
/// `n` is padded to a multiple of 8 and `k` to a multiple of 4 with zeros.
#[derive(Debug)]
pub struct PackedWeight {
    pub(crate) packed: Buffer<f32>,
    pub(crate) no_bias: Buffer<f32>,
    n: usize,
    k: usize,
    precision: Precision,
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
        expect_len(KERNEL, "w", w.len(), n * k, "n*k")?;
        let mut weight = Self::zeros(device, name, n, k)?;
        weight.packed.write(&packed_order(w, n, k))?;
        Ok(weight)
    }

    /// Packs the transpose of `w` `[k, n]` on the host: the operand of the gradient to the input.
    ///
    /// # Errors
    /// As [`PackedWeight::new`].
    pub fn transposed(device: &Device, name: &str, w: &[f32], n: usize, k: usize) -> Result<Self, KernelError> {
        expect_len(KERNEL, "w", w.len(), n * k, "k*n")?;
        let columns: Vec<f32> = (0..n * k).map(|i| w[(i % k) * n + i / k]).collect();
        Self::new(device, name, &columns, n, k)
    }

    /// The matrix in its packed order.
    #[must_use]
    pub fn packed(&self) -> &Buffer<f32> {
        &self.packed
    }

    /// A zero matrix, to be filled by [`gather`].
    ///
    /// # Errors
    /// [`KernelError::Allocation`] when memory runs out.
    pub fn zeros(device: &Device, name: &str, n: usize, k: usize) -> Result<Self, KernelError> {
        let padded_n = n.next_multiple_of(LANES);
        Ok(Self {
            packed: device.buffer(name, padded_n * k.next_multiple_of(TEXEL))?,
            no_bias: device.buffer(&format!("{name}.no_bias"), padded_n)?,
            n,
            k,
            precision: Precision::F32,
        })
    }

    /// The same weight, whose products are of this precision.
    #[must_use]
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    /// What its products are rounded to.
    #[must_use]
    pub fn precision(&self) -> Precision {
        self.precision
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

/// Packs a matrix that lies on the device, whole or as the top left part of a wider buffer.
///
/// # Shapes
/// in `src` per `order`; the size of W is that of `out` before padding · out `out` (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn gather(rec: &mut Recorder, src: &Buffer<f32>, order: Order, out: &mut PackedWeight) -> Result<(), KernelError> {
    let (n, k) = (out.n, out.k);
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
    let total = out.packed.len() / TEXEL;
    let params = pack_gather::Params {
        n: as_u32(n),
        k: as_u32(k),
        stride_n: as_u32(stride_n),
        stride_k: as_u32(stride_k),
        total: as_u32(total),
    };
    rec.dispatch(pack_gather::Bind { src, packed: &mut out.packed }, params, Grid::threads(total))
}
