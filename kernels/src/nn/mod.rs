//! Layers of neural networks: matrix product, attention, norms, activations, embeddings.

pub mod activation;
pub mod attention;
pub mod axpy;
mod check;
pub mod column_sum;
pub mod conv2d;
pub mod conv3d;
pub mod embedding;
pub mod half_check;
pub mod l2_normalize;
pub mod layer_norm;
pub mod matmul;
pub mod max_pool;
pub mod pack;
pub mod patch_embed;
pub mod row_mean;
pub mod transpose;
