//! Twin of `loss/pixel_step`.

use crate::reference::real::Real;

/// Mean squared and mean absolute difference over colours of `[n,4]`, and the gradient of their sum with `weights`,
/// fourth channel 0.
pub fn step<R: Real>(image: &[R], reference: &[R], weights: [R; 2]) -> ([R; 2], Vec<R>) {
    let mean = R::of(1.0) / R::of(image.len() as f64 * 0.75);
    let mut values = [R::of(0.0); 2];
    let mut grad = vec![R::of(0.0); image.len()];
    for i in (0..image.len()).filter(|i| i % 4 < 3) {
        let d = image[i] - reference[i];
        let sign = if d > R::of(0.0) {
            R::of(1.0)
        } else if d < R::of(0.0) {
            R::of(-1.0)
        } else {
            d
        };
        values[0] += d * d * mean;
        values[1] += d.abs() * mean;
        grad[i] = (weights[0] * (d + d) + weights[1] * sign) * mean;
    }
    (values, grad)
}
