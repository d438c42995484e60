//! Embedding.

mod checkpoint;
mod clips;
mod embedding;
mod visibility;
