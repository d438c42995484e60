//! Embedding.

mod embedding;
mod visibility;
