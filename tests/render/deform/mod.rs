//! Splats at a moment in time.

mod field;
mod mixed;
mod warp;
