//! Twin of `loss/bce`.

use crate::loss::bce::Objective;
use crate::reference::real::Real;

fn softplus<R: Real>(x: R) -> R {
    let one = R::of(1.0);
    x.max(R::of(0.0)) + (one + (-x.abs()).exp()).ln()
}

fn sigmoid<R: Real>(x: R) -> R {
    R::of(1.0) / (R::of(1.0) + (-x).exp())
}

/// Value of one group: `logits` and `target` `[R·L]`.
pub fn forward<R: Real>(objective: Objective, logits: &[R], target: &[R]) -> R {
    let one = R::of(1.0);
    let term = |(&o, &t): (&R, &R)| match objective {
        Objective::Margin { margin } => softplus(R::of(f64::from(margin)) - (t + t - one) * o),
        Objective::Chance => o * o,
        Objective::Bce | Objective::InverseBce { .. } | Objective::Hinge { .. } => softplus(o) - o * t,
    };
    logits.iter().zip(target).map(term).sum::<R>() / R::of(logits.len() as f64)
}

/// Loss that belongs to a value.
pub fn loss<R: Real>(objective: Objective, value: R) -> R {
    let inverse = |b: R, eps: f32| R::of(1.0) / (b + R::of(f64::from(eps)));
    match objective {
        Objective::Bce | Objective::Margin { .. } | Objective::Chance => value,
        Objective::InverseBce { eps } => inverse(value, eps),
        Objective::Hinge { eps } => {
            let chance = R::of(std::f64::consts::LN_2);
            inverse(if value > chance { chance } else { value }, eps)
        }
    }
}

/// Gradient of `weight · loss` to the logits of one group.
pub fn backward<R: Real>(objective: Objective, weight: R, logits: &[R], target: &[R]) -> Vec<R> {
    let (zero, one) = (R::of(0.0), R::of(1.0));
    let value = forward(objective, logits, target);
    let inverse = |eps: f32| one / (value + R::of(f64::from(eps)));
    let outer = match objective {
        Objective::InverseBce { eps } => -(inverse(eps) * inverse(eps)),
        Objective::Hinge { eps } if value < R::of(std::f64::consts::LN_2) => -(inverse(eps) * inverse(eps)),
        Objective::Hinge { .. } => zero,
        _ => one,
    };
    let per_group = R::of(logits.len() as f64);
    let inner = |(&o, &t): (&R, &R)| match objective {
        Objective::Margin { margin } => {
            let s = t + t - one;
            -s * sigmoid(R::of(f64::from(margin)) - s * o)
        }
        Objective::Chance => o + o,
        _ => sigmoid(o) - t,
    };
    logits.iter().zip(target).map(|pair| inner(pair) * outer * weight / per_group).collect()
}
