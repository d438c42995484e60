//! Twin of `optim/adam_step`.

use crate::reference::real::Real;

/// Hyperparameters of one step; `bias1`, `bias2` are 1 − βᵗ.
#[derive(Clone, Copy, Debug)]
pub struct Adam<'a, R> {
    /// Learning rate.
    pub lr: R,
    /// Decay of the first moment.
    pub beta1: R,
    /// Decay of the second moment.
    pub beta2: R,
    /// Added to the root.
    pub eps: R,
    /// 1 − β₁ᵗ
    pub bias1: R,
    /// 1 − β₂ᵗ
    pub bias2: R,
    /// 1 − decay
    pub keep: R,
    /// Largest magnitude that a parameter has after the step.
    pub bound: R,
    /// Elements of a row, how many of them move at `lr`, and the rate of the others.
    pub tail: Option<(usize, usize, R)>,
    /// Elements of a row, and a factor on the rates for each row.
    pub rates: Option<(usize, &'a [R])>,
}

/// One Adam step: Kingma & Ba 2015, Algorithm 1; decoupled decay of Loshchilov & Hutter 2019, Algorithm 2. All slices
/// `[n]`.
pub fn step<R: Real>(c: &Adam<'_, R>, param: &mut [R], v_param: &[R], exp_avg: &mut [R], exp_avg_sq: &mut [R]) {
    let one = R::of(1.0);
    for i in 0..param.len() {
        exp_avg[i] = c.beta1 * exp_avg[i] + (one - c.beta1) * v_param[i];
        exp_avg_sq[i] = c.beta2 * exp_avg_sq[i] + (one - c.beta2) * v_param[i] * v_param[i];
        let update = (exp_avg[i] / c.bias1) / ((exp_avg_sq[i] / c.bias2).sqrt() + c.eps);
        let lr = match c.tail {
            Some((row, head, lr)) if i % row >= head => lr,
            _ => c.lr,
        };
        let factor = c.rates.map_or(one, |(row, factors)| factors[i / row]);
        let moved = c.keep * param[i] - factor * lr * update;
        param[i] = if moved > c.bound {
            c.bound
        } else if moved < -c.bound {
            -c.bound
        } else {
            moved
        };
    }
}
