//! Twin of `nn/activation`.

use crate::nn::activation::Activation;
use crate::reference::real::Real;

/// Slope of the sigmoid in QuickGELU.
const QUICK: f64 = 1.702;

/// Error function in f64 by its series with positive terms: erf(x) = 2/√π e^(−x²) Σ 2ⁿ x^(2n+1) / (2n+1)!!.
pub fn erf<R: Real>(x: R) -> R {
    let x = x.f64();
    // Beyond 6 the error function differs from 1 by less than 3e-17; NaN takes the series and stays NaN.
    if x.abs() > 6.0 {
        return R::of(x.signum());
    }
    let mut term = x;
    let mut sum = x;
    let mut odd = 1.0;
    for _ in 0..160 {
        odd += 2.0;
        term *= 2.0 * x * x / odd;
        sum += term;
    }
    R::of(std::f64::consts::FRAC_2_SQRT_PI * (-(x * x)).exp() * sum)
}

fn sigmoid<R: Real>(x: R) -> R {
    R::of(1.0) / (R::of(1.0) + (-x).exp())
}

fn cdf<R: Real>(x: R) -> R {
    R::of(0.5) * (R::of(1.0) + erf(x * R::of(std::f64::consts::FRAC_1_SQRT_2)))
}

/// act(x).
pub fn value<R: Real>(activation: Activation, x: R) -> R {
    match activation {
        Activation::Identity => x,
        Activation::Relu => {
            if x <= R::of(0.0) {
                R::of(0.0)
            } else {
                x
            }
        }
        Activation::QuickGelu => x * sigmoid(R::of(QUICK) * x),
        Activation::Gelu => x * cdf(x),
    }
}

/// act'(x).
pub fn slope<R: Real>(activation: Activation, x: R) -> R {
    match activation {
        Activation::Identity => R::of(1.0),
        Activation::Relu => R::of(if x <= R::of(0.0) { 0.0 } else { 1.0 }),
        Activation::QuickGelu => {
            let s = sigmoid(R::of(QUICK) * x);
            s + R::of(QUICK) * x * s * (R::of(1.0) - s)
        }
        Activation::Gelu => {
            let density = R::of(0.5 * std::f64::consts::FRAC_2_SQRT_PI * std::f64::consts::FRAC_1_SQRT_2);
            cdf(x) + x * density * (R::of(-0.5) * x * x).exp()
        }
    }
}

/// `y = act(x)`, `[n]`.
pub fn forward<R: Real>(activation: Activation, x: &[R]) -> Vec<R> {
    x.iter().map(|v| value(activation, *v)).collect()
}

/// `v_x = v_y act'(x)`, `[n]`.
pub fn backward<R: Real>(activation: Activation, x: &[R], v_y: &[R]) -> Vec<R> {
    x.iter().zip(v_y).map(|(v, g)| *g * slope(activation, *v)).collect()
}
