//! Tensors as a `.pth` file holds them.

/// Values of a [`Tensor`], row-major.
#[derive(Clone, Debug, PartialEq)]
pub enum TensorData {
    /// From float, double (rounded), half and bfloat16 storages.
    F32(Vec<f32>),
    /// From long, int, short, char and byte storages.
    I64(Vec<i64>),
    /// From bool storages.
    Bool(Vec<bool>),
}

/// A dense tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Sizes, outermost first; empty for a scalar.
    pub shape: Vec<usize>,
    /// Values, as many as the product of `shape`.
    pub data: TensorData,
}
