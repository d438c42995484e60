//! Learning-rate schedules.

/// Half-cosine decay from 1 at step 0 to `floor` at `steps`.
///
/// # Equation: SGDR without restarts, Loshchilov & Hutter 2017, Eq. 5
#[must_use]
#[allow(clippy::cast_possible_truncation, reason = "a factor between 0 and 1")]
pub fn cosine(step: usize, steps: usize, floor: f32) -> f32 {
    let progress = step as f64 / steps.max(1) as f64;
    let wave = 0.5 * (1.0 + (std::f64::consts::PI * progress).cos());
    floor + (1.0 - floor) * wave as f32
}

#[cfg(test)]
mod tests {
    use super::cosine;

    #[test]
    fn it_starts_at_one_and_ends_at_the_floor() {
        assert!((cosine(0, 10, 0.1) - 1.0).abs() < 1e-6, "start");
        assert!((cosine(5, 10, 0.0) - 0.5).abs() < 1e-6, "middle");
        assert!((cosine(10, 10, 0.1) - 0.1).abs() < 1e-6, "end");
        assert!(cosine(0, 0, 0.1).is_finite(), "no steps");
    }
}
