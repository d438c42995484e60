//! What a copy would score in a leak that nothing was done to: how much could have been found.

use super::estimate::estimate_of;
use super::fidelity::TRIAL_COPY;
use super::issue::Issue;
use super::seen::Seen;
use crate::error::EngineError;

/// The score, in the unit of [`Code::score`](super::code::Code::score), that a copy would have if the leak showed it as
/// it was stamped, under as much noise: that of a copy that nobody has.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn unspoilt_score(issue: &Issue<'_>, seen: &mut dyn Seen, noise: f64) -> Result<f64, EngineError> {
    let key = issue.copy_key(TRIAL_COPY);
    let values: Vec<f64> = issue.code().offsets(&key).collect();
    let chips = estimate_of(issue, seen, &values, noise)?;
    issue.code().score(&chips, &key)
}
