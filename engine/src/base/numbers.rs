//! Numbers in single precision, and the middle one.

/// Rounded to single precision, which is what the engine computes in.
#[must_use]
#[allow(
    clippy::cast_possible_truncation,
    reason = "the engine computes in f32; a double out of range becomes infinite, which every reader refuses"
)]
pub fn narrow(value: f64) -> f32 {
    value as f32
}

/// The middle one; 0 of none.
#[must_use]
pub fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.collect();
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(0.0)
}
