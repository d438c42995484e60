//! Twins of `glsl/loss`.

pub mod bce;
pub mod l1;
pub mod mse;
pub mod offset_penalty;
pub mod ssim;
pub mod sum;

use super::Real;

/// Mean of `term(image - reference) -> (value, slope)` over colours of `[n,4]`, and its gradient.
fn per_colour<R: Real>(image: &[R], reference: &[R], term: impl Fn(R) -> (R, R)) -> (R, Vec<R>) {
    let mean = R::of(1.0) / R::of(image.len() as f64 * 0.75);
    let mut value = R::of(0.0);
    let mut grad = vec![R::of(0.0); image.len()];
    for i in (0..image.len()).filter(|i| i % 4 < 3) {
        let (v, slope) = term(image[i] - reference[i]);
        value += v * mean;
        grad[i] = slope * mean;
    }
    (value, grad)
}
