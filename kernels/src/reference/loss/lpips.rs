//! Twin of `loss/lpips_step`.

use crate::loss::lpips::EPS;
use crate::reference::real::Real;

fn length<R: Real>(x: &[R]) -> R {
    x.iter().map(|v| *v * *v).sum::<R>().sqrt()
}

/// Distance of `x` and `y` `[rows, channels]`, and its gradient at the input of the ReLU that `x` came out of:
/// Σ w (x / (|x| + ε) − y / (|y| + ε))², 0 where x is not above 0.
pub fn step<R: Real>(x: &[R], y: &[R], weight: &[R]) -> (R, Vec<R>) {
    let channels = weight.len();
    let (mut value, mut v_x) = (R::of(0.0), Vec::with_capacity(x.len()));
    for (x, y) in x.chunks_exact(channels).zip(y.chunks_exact(channels)) {
        let (norm, shift, other) = (length(x), length(x) + R::of(EPS), length(y) + R::of(EPS));
        let differences: Vec<R> = x.iter().zip(y).map(|(a, b)| *a / shift - *b / other).collect();
        let slopes: Vec<R> = differences.iter().zip(weight).map(|(d, w)| R::of(2.0) * *w * *d).collect();
        value += differences.iter().zip(weight).map(|(d, w)| *w * *d * *d).sum::<R>();
        let along = slopes.iter().zip(x).map(|(g, a)| *g * *a).sum::<R>();
        for (a, g) in x.iter().zip(&slopes) {
            v_x.push(if *a <= R::of(0.0) { R::of(0.0) } else { *g / shift - *a * along / (norm * shift * shift) });
        }
    }
    (value, v_x)
}
