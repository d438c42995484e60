//! Studies and tools for research.

mod cross_examination;
pub(crate) mod forgery;
mod study;
