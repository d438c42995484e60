//! Embedding.

mod checkpoint;
mod clips;
mod embedding;
mod pool;
mod visibility;
