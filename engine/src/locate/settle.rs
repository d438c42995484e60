//! Frames of a shot where they fit best, by one lens and beside each other.

use std::iter::once;

use super::align::{Fit, Plan, Way, align, costs_of};
use super::mend::{look_again, over_all_moments};
use super::picture::Picture;
use super::pose::Pose;
use super::search::{LAST, TELL, TIED, last_steps, with_lens};
use super::shots::{both_ways, is_same};
use super::stage::Stage;
use super::work::Work;
use crate::base::numbers::median;
use crate::base::spread::spread;
use crate::error::EngineError;

/// Frames of a shot that tell its lens, and of those of them whose turns hide what moves how many do: they take exact
/// steps, which cost many pictures.
const TELLING: usize = 10;
const TELLING_EXACTLY: usize = 4;
/// What a place costs, of an earlier one, to be begun at instead: movement is even, and where a turn hides it pictures
/// say little of how far along it is.
const MUCH_BETTER: f64 = 0.6;
/// How near places are to be as good as one, px: steps lead from either to the same.
const SAME_PX: f64 = 0.5;
/// Steps of those that tell the lens, where a turn hides what moves.
const TELL_EXACTLY: Plan = Plan { way: Way::Exact, ..TELL };

/// Brings all frames of a shot to where they fit best with one lens, and beside each other.
pub(super) fn settle(
    stage: &mut Stage,
    frames: &[Picture],
    fits: &mut [Fit],
    begun: usize,
    work: &mut Work<'_>,
) -> Result<(), EngineError> {
    let lens = lens_of(stage, frames, fits, work)?;
    // From the frame that was found first to both ends: what was mended there is mended in the next, too.
    let found = fits.to_vec();
    for way in once(vec![begun]).chain(both_ways(begun, frames.len())) {
        for at in way {
            work.one("cameras refined")?;
            let toward = |by: usize| if at > begun { at.checked_sub(by) } else { Some(at + by) };
            let between = begun.min(at)..=begun.max(at);
            let known = |by: usize| toward(by).filter(|other| at != begun && between.contains(other));
            if let Some(beside) = known(1).filter(|beside| is_same(&frames[at].gray, &frames[*beside].gray)) {
                fits[at] = fits[beside];
                continue;
            }
            let mut starts = Vec::new();
            if let Some(last) = known(1) {
                let ahead = known(2).map(|earlier| fits[last].pose.since(&fits[earlier].pose));
                starts.push(fits[last].pose.moved(&ahead.unwrap_or_default()));
                starts.push(found[at].pose.moved(&fits[last].pose.since(&found[last].pose)));
            }
            starts.push(found[at].pose);
            fits[at] = from_the_first(stage, &frames[at], &starts, lens)?;
        }
    }
    look_again(stage, frames, fits, work)?;
    if over_all_moments(stage, frames, fits, lens, &mut || work.look("other moments"))? {
        // The lens was told by frames that were elsewhere.
        let lens = lens_of(stage, frames, fits, work)?;
        for (frame, fit) in frames.iter().zip(fits) {
            work.look("cameras refined")?;
            *fit = last_steps(stage, &frame.gray, &with_lens(fit.pose, lens))?;
        }
    }
    Ok(())
}

/// The lens of a shot, as some of its frames tell it.
fn lens_of(stage: &mut Stage, frames: &[Picture], fits: &[Fit], work: &mut Work<'_>) -> Result<f64, EngineError> {
    let usual = median(fits.iter().map(|fit| fit.pose.lens));
    let said = |fit: &Fit| Weighed { value: fit.pose.lens, weight: fit.lens_weight };
    let (mut lenses, mut tied) = (Vec::new(), Vec::new());
    for at in spread(frames.len(), TELLING) {
        work.look("the lens")?;
        let fit = align(stage, &frames[at].gray, &with_lens(fits[at].pose, usual), TELL)?;
        if fit.tied > TIED {
            tied.push((at, fit.pose));
        } else {
            lenses.push(said(&fit));
        }
    }
    for one in spread(tied.len(), TELLING_EXACTLY) {
        work.look("the lens")?;
        let (at, pose) = &tied[one];
        lenses.push(said(&align(stage, &frames[*at].gray, pose, TELL_EXACTLY)?));
    }
    Ok(weighted_median(lenses).unwrap_or(usual))
}

/// A frame's last steps, from the first of several places unless it fits much better in another.
fn from_the_first(stage: &mut Stage, frame: &Picture, starts: &[Pose], lens: f64) -> Result<Fit, EngineError> {
    let mut apart: Vec<Pose> = Vec::new();
    for start in starts.iter().map(|start| with_lens(*start, lens)) {
        if apart.iter().all(|other| start.apart_px(other, frame.gray.width as f64) >= SAME_PX) {
            apart.push(start);
        }
    }
    let mut best = 0;
    if apart.len() > 1 {
        let costs = costs_of(stage, &frame.gray, &apart, LAST)?;
        for at in 1..apart.len() {
            best = if costs[at] < MUCH_BETTER * costs[best] { at } else { best };
        }
    }
    last_steps(stage, &frame.gray, &apart[best])
}

/// A number and how much it counts.
#[derive(Clone, Copy)]
struct Weighed {
    value: f64,
    weight: f64,
}

/// The number on both sides of which there is as much weight; none where there is none.
fn weighted_median(mut numbers: Vec<Weighed>) -> Option<f64> {
    numbers.sort_by(|a, b| a.value.total_cmp(&b.value));
    let half = 0.5 * numbers.iter().map(|number| number.weight).sum::<f64>();
    let mut sum = 0.0;
    numbers.into_iter().find_map(|Weighed { value, weight }| {
        sum += weight;
        (weight > 0.0 && sum >= half).then_some(value)
    })
}
