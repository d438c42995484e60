//! Closeness that a NaN cannot pass.

/// Worst `|got - want| / (atol + rtol |want|)`; infinite when anything is NaN or lengths differ.
pub(crate) fn worst_ratio(got: &[f32], want: &[f32], atol: f32, rtol: f32) -> f32 {
    if got.len() != want.len() {
        return f32::INFINITY;
    }
    let error = |(g, w): (&f32, &f32)| if g == w { 0.0 } else { (g - w).abs() / (atol + rtol * w.abs()) };
    got.iter().zip(want).map(error).fold(0.0, |worst: f32, e| {
        if e <= worst {
            worst
        } else if e.is_nan() {
            f32::INFINITY
        } else {
            e
        }
    })
}

/// Fails unless every element lies within `atol + rtol |want|`.
#[track_caller]
pub(crate) fn assert_close(got: &[f32], want: &[f32], atol: f32, rtol: f32) {
    let worst = worst_ratio(got, want, atol, rtol);
    let at = got.iter().zip(want).position(|(g, w)| worst_ratio(&[*g], &[*w], atol, rtol) == worst);
    let pair = at.map(|i| (i, got[i], want[i]));
    assert!(
        worst <= 1.0,
        "{worst} x the tolerance (atol {atol}, rtol {rtol}); lengths {} and {}; worst at {pair:?}",
        got.len(),
        want.len()
    );
}

/// Cosine of the angle between two vectors; NaN when either is zero or not finite.
pub(crate) fn cosine(a: &[f32], b: &[f32]) -> f64 {
    let dot = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(p, q)| f64::from(*p) * f64::from(*q)).sum::<f64>();
    dot(a, b) / (dot(a, a).sqrt() * dot(b, b).sqrt())
}

#[test]
fn nan_and_length_mismatch_are_never_close() {
    assert!(worst_ratio(&[f32::NAN], &[f32::NAN], 1.0, 1.0) > 1.0, "NaN against NaN");
    assert!(worst_ratio(&[0.0, f32::NAN], &[0.0, 0.0], 1.0, 1.0) > 1.0, "NaN against a number");
    assert!(worst_ratio(&[0.0], &[0.0, 0.0], 1.0, 1.0) > 1.0, "lengths");
    assert!(worst_ratio(&[f32::INFINITY], &[1.0], 1.0, 1.0) > 1.0, "infinity against a number");
    assert!(worst_ratio(&[1.5], &[1.0], 0.5, 0.0) <= 1.0, "on the edge");
}
