//! The owner's mark: key, extractor, embedding.

mod embed;
mod extractor;
pub(crate) mod key;
