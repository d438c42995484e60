//! Closeness that a NaN cannot pass.

use std::cmp::Ordering;

/// The largest of some numbers; NaN when any of them is, and when there is none: no check passes for want of numbers.
pub(crate) fn largest<T: PartialOrd + From<f32>>(values: impl IntoIterator<Item = T>) -> T {
    let larger = |most: T, value: T| match most.partial_cmp(&value) {
        None => T::from(f32::NAN),
        Some(Ordering::Less) => value,
        Some(_) => most,
    };
    values.into_iter().reduce(larger).unwrap_or(T::from(f32::NAN))
}

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

/// Greatest error of a CLIP feature relative to its length: the agreement with other implementations that is asked for.
/// The rounding of f32 comes to 5e-7 through the miniature's layers and to 1.5e-6 through those of ViT-B/32.
const FEATURE_RTOL: f64 = 2e-4;

/// `‖got - want‖ / ‖want‖`; infinite when lengths differ, NaN when anything is NaN or `want` is zero.
pub(crate) fn relative_distance(got: &[f32], want: &[f32]) -> f64 {
    if got.len() != want.len() {
        return f64::INFINITY;
    }
    let length = |squares: &mut dyn Iterator<Item = f64>| squares.sum::<f64>().sqrt();
    let error = length(&mut got.iter().zip(want).map(|(g, w)| (f64::from(*g) - f64::from(*w)).powi(2)));
    error / length(&mut want.iter().map(|w| f64::from(*w).powi(2)))
}

/// Fails unless `got` holds as many rows of `width` as `want`, each a feature that is right by length, and so in every
/// element.
#[track_caller]
pub(crate) fn assert_features_close(got: &[f32], want: &[f32], width: usize) {
    assert_eq!((got.len(), got.len() % width), (want.len(), 0), "whole rows, as many");
    for (row, (got, want)) in got.chunks_exact(width).zip(want.chunks_exact(width)).enumerate() {
        let error = relative_distance(got, want);
        assert!(
            error <= FEATURE_RTOL,
            "row {row}: {error} of the feature's length off, at most {FEATURE_RTOL} allowed"
        );
    }
}

#[test]
fn features_with_a_nan_are_never_close() {
    let fails = |got: &[f32], want: &[f32]| std::panic::catch_unwind(|| assert_features_close(got, want, 2)).is_err();
    assert!(!fails(&[3.0, 4.0, 0.0, 1.0], &[3.0, 4.000_9, 0.0, 1.0]), "2e-4 of a length of 5 is 1e-3");
    assert!(fails(&[3.0, 4.0, 0.0, 1.0], &[3.0, 4.0, 0.0, 1.000_9]), "each row counts by itself");
    assert!(fails(&[3.0, f32::NAN], &[3.0, 4.0]) && fails(&[3.0, 4.0], &[3.0, f32::NAN]), "NaN");
    assert!(fails(&[f32::INFINITY, 4.0], &[f32::INFINITY, 4.0]), "infinity");
    assert!(fails(&[0.0, 0.0], &[0.0, 0.0]), "a feature without a direction");
    assert!(fails(&[3.0, 4.0], &[3.0, 4.0, 0.0, 1.0]) && fails(&[3.0], &[3.0]), "rows");
}

#[test]
fn the_largest_of_numbers_is_a_nan_where_there_is_one() {
    assert_eq!(largest([-3.0, -1.0, -2.0_f32]).to_bits(), (-1.0_f32).to_bits(), "the largest, not the farthest");
    for at in 0..3 {
        let mut values = [1.0, 2.0, 3.0];
        values[at] = f64::NAN;
        assert!(largest(values).is_nan(), "NaN at {at}");
    }
    assert!(largest([f32::NAN]).is_nan() && largest::<f32>([]).is_nan(), "nothing but NaN, and nothing");
}

#[test]
fn nan_and_length_mismatch_are_never_close() {
    assert!(worst_ratio(&[f32::NAN], &[f32::NAN], 1.0, 1.0) > 1.0, "NaN against NaN");
    assert!(worst_ratio(&[0.0, f32::NAN], &[0.0, 0.0], 1.0, 1.0) > 1.0, "NaN against a number");
    assert!(worst_ratio(&[0.0], &[0.0, 0.0], 1.0, 1.0) > 1.0, "lengths");
    assert!(worst_ratio(&[f32::INFINITY], &[1.0], 1.0, 1.0) > 1.0, "infinity against a number");
    assert!(worst_ratio(&[1.5], &[1.0], 0.5, 0.0) <= 1.0, "on the edge");
}
