//! Both towers against transformers.

mod mini;
mod vit_b32;
