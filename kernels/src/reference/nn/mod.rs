//! Twins of the `nn` kernels.

pub mod activation;
pub mod attention;
pub mod axpy;
pub mod column_sum;
pub mod conv2d;
pub mod conv3d;
pub mod embedding;
pub mod l2_normalize;
pub mod layer_norm;
pub mod matmul;
pub mod max_pool;
pub mod pack;
pub mod patch_embed;
pub mod row_mean;
pub mod transpose;

use super::Real;

/// A size as a number.
#[allow(clippy::cast_precision_loss, reason = "sizes in tests are far below 2^53")]
fn count<R: Real>(n: usize) -> R {
    R::of(n as f64)
}
