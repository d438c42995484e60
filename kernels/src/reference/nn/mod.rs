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
