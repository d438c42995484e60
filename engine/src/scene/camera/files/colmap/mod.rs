//! COLMAP reconstructions: `cameras` and `images`, as text or binary; points are not read.

mod binary;
mod models;
mod reconstruction;
mod text;

pub(super) use reconstruction::Files;
