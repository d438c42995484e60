//! Embedding.

mod clips;
mod embedding;
mod visibility;
