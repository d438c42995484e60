//! CLIP towers against transformers, and checkpoints that must be refused.

mod mini;
mod weights;
