//! The chips that a leak shows, estimated together: splats overlap, so that what one says is said by its neighbours
//! too, and few large ones would outvote all others.
//!
//! Films are r = A M z + noise, with the renderer A, amplitudes M and chips z of mean 0 and variance 1. What tells
//! copies apart best is then (Mᵀ Aᵀ W A M + κσ²)⁻¹ Mᵀ Aᵀ W r, the mean of z after the film is seen; a few
//! steps of conjugate gradients come near enough. κ is there because a codec's errors are not each pixel's own.
//! Everything here follows from film, original and amplitudes; no key takes part.

use super::issue::Issue;
use super::seen::{Seen, SplatEvidence};
use crate::error::EngineError;

/// Steps before the noise is known, and behind.
const STEPS: [usize; 2] = [3, 6];
/// What a splat shows of a change of its own, as a part of all that is seen through it: for the preconditioner, which
/// only decides how fast the steps converge.
const OWN_PART: f64 = 0.3;
/// Least noise of a sample, its variance: that of rounding to 8 bits.
const LEAST_NOISE: f64 = 1.0 / (12.0 * 255.0 * 255.0);

/// What was estimated.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The mean of each chip after the leak is seen.
    pub chips: Vec<f64>,
    /// The variance of what else is in a sample.
    pub noise: f64,
}

/// What was estimated without a look at any code: the same for all issues of an asset at one strength.
#[derive(Clone, Debug)]
pub struct Uncoded {
    chips: Vec<f64>,
    strength: Vec<f64>,
    noise: f64,
    together: f64,
}

/// Estimates the chips of an issue from a leak.
///
/// # Errors
/// [`EngineError::Usage`] unless there is evidence of each splat; when memory runs out or the device fails.
pub fn estimate(issue: &Issue<'_>, seen: &mut dyn Seen) -> Result<Estimate, EngineError> {
    Ok(Uncoded::of(issue, seen)?.for_issue(issue))
}

impl Uncoded {
    /// Estimates chips from a leak; of the issue, only where they are and how far they move colours.
    ///
    /// # Errors
    /// As [`estimate`].
    pub fn of(issue: &Issue<'_>, seen: &mut dyn Seen) -> Result<Self, EngineError> {
        let SplatEvidence { residual, response, samples, squares } = seen.evidence().clone();
        let right = issue.collect(&residual)?;
        let strength = issue.collect_squared(&response)?;
        let (samples, together) = ((samples as f64).max(1.0), seen.together());
        let mut noise = (squares / samples).max(LEAST_NOISE);
        let mut chips = vec![0.0; right.len()];
        for steps in STEPS {
            let mut normal = |chips: &[f64]| issue.collect(&seen.normal(&issue.spread(chips))?);
            let seen_of_chips = descend(&mut chips, &right, &strength, together * noise, steps, &mut normal)?;
            // |r - A M z|², with what is already known.
            let left = squares - 2.0 * dot(&chips, &right) + dot(&chips, &seen_of_chips);
            noise = (left / samples).max(LEAST_NOISE);
        }
        Ok(Self { chips, strength, noise, together })
    }

    /// What of it tells the copies of an issue apart.
    #[must_use]
    pub fn for_issue(&self, issue: &Issue<'_>) -> Estimate {
        let Self { strength, noise, together, .. } = self;
        let mut chips = self.chips.clone();
        issue.take_off_mean(&mut chips, strength, together * noise);
        Estimate { chips, noise: *noise }
    }
}

/// What would be estimated of chips that are `values`, if nothing had been done to them and there were as much noise.
///
/// # Errors
/// As [`estimate`].
pub fn estimate_of(
    issue: &Issue<'_>,
    seen: &mut dyn Seen,
    values: &[f64],
    noise: f64,
) -> Result<Vec<f64>, EngineError> {
    let strength = issue.collect_squared(&seen.evidence().response.clone())?;
    let together = seen.together();
    let mut normal = |chips: &[f64]| issue.collect(&seen.normal(&issue.spread(chips))?);
    let right = normal(values)?;
    let mut chips = vec![0.0; right.len()];
    descend(&mut chips, &right, &strength, together * noise, STEPS.iter().sum(), &mut normal)?;
    Ok(chips)
}

/// What a leak would say of each chip if chips were these.
type Normal<'a> = dyn FnMut(&[f64]) -> Result<Vec<f64>, EngineError> + 'a;

/// Steps of preconditioned conjugate gradients on (normal + noise)·chips = right, from where `chips` are. Returns the
/// normal part of what was reached.
fn descend(
    chips: &mut [f64],
    right: &[f64],
    strength: &[f64],
    noise: f64,
    steps: usize,
    normal: &mut Normal<'_>,
) -> Result<Vec<f64>, EngineError> {
    let mut seen = if chips.iter().any(|z| *z != 0.0) { normal(chips)? } else { vec![0.0; chips.len()] };
    let precondition = |r: &[f64]| -> Vec<f64> {
        r.iter().zip(strength).map(|(r, strength)| r / (OWN_PART * strength + noise)).collect()
    };
    let rest = right.iter().zip(&seen).zip(chips.iter());
    let mut rest: Vec<f64> = rest.map(|((right, seen), z)| right - seen - noise * z).collect();
    let mut ahead = precondition(&rest);
    let mut direction = ahead.clone();
    let mut size = dot(&rest, &ahead);
    for _ in 0..steps {
        let along = normal(&direction)?;
        let curvature = dot(&direction, &along) + noise * dot(&direction, &direction);
        if !(curvature > 0.0 && size > 0.0) {
            break;
        }
        let step = size / curvature;
        for i in 0..chips.len() {
            chips[i] += step * direction[i];
            seen[i] += step * along[i];
            rest[i] -= step * (along[i] + noise * direction[i]);
        }
        ahead = precondition(&rest);
        let next = dot(&rest, &ahead);
        for (direction, ahead) in direction.iter_mut().zip(&ahead) {
            *direction = ahead + next / size * *direction;
        }
        size = next;
    }
    Ok(seen)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
