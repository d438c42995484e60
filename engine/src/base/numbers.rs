//! Numbers in single precision.

/// Rounded to single precision, which is what the engine computes in.
#[must_use]
#[allow(
    clippy::cast_possible_truncation,
    reason = "the engine computes in f32; a double out of range becomes infinite, which every reader refuses"
)]
pub fn narrow(value: f64) -> f32 {
    value as f32
}
