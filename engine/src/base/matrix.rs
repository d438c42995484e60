//! Tensors of files and devices as matrices of double precision, and back.

use nalgebra::DMatrix;

/// Values in rows of `width`.
pub fn rows(values: &[f32], width: usize) -> DMatrix<f64> {
    DMatrix::from_fn(values.len() / width, width, |i, j| f64::from(values[i * width + j]))
}

/// The values of a matrix, row by row.
pub fn row_major(matrix: &DMatrix<f64>) -> Vec<f32> {
    matrix.transpose().iter().map(|v| single(*v)).collect()
}

/// Rounded to single precision.
#[allow(clippy::cast_possible_truncation, reason = "single precision is what the device takes")]
pub fn single(value: f64) -> f32 {
    value as f32
}

/// ‖a − b‖ / ‖b‖; infinite for different lengths, NaN for values that are none.
pub fn share_apart(own: &[f32], known: &[f32]) -> f64 {
    if own.len() != known.len() {
        return f64::INFINITY;
    }
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let apart = norm(&mut own.iter().zip(known).map(|(a, b)| f64::from(*a) - f64::from(*b)));
    apart / norm(&mut known.iter().map(|v| f64::from(*v)))
}
