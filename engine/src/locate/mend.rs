//! Frames that are looked at again once their shot is known.

use super::align::{Fit, align, costs_of, moments};
use super::gray::Gray;
use super::picture::Picture;
use super::pose::Pose;
use super::search::{LAST, NEAR, NEXT, SCANNED, last_steps, over_the_motion, with_lens};
use super::shots::{both_ways, is_same};
use super::stage::Stage;
use super::work::Work;
use crate::base::numbers::median;
use crate::error::EngineError;

/// How far a frame is from between its neighbours to be looked at again: in pixels, and of what is usual.
const APART_PX: f64 = 2.0;
const APART_OF_USUAL: f64 = 4.0;
/// What a frame costs, of what is usual beside it, to be looked at again; moments that are tried then.
const DEAR: f64 = 1.4;
const BESIDE: usize = 4;
const ALIKE: usize = 3;
/// Places of a frame, over all moments, that are looked at closely.
const CLOSER: usize = 2;
/// How often steps begin anew from where they came to, as long as that helps: from far off they follow a bent valley.
const ROUNDS: usize = 4;
/// What a place costs, of where a frame is, to be taken instead: coding alone makes less of a difference to so many
/// pixels.
const BETTER: f64 = 0.98;
/// How far apart two places are to be two, px: nearer ones are the same after another step or two, and say nothing of
/// the frames beside.
const ELSEWHERE_PX: f64 = 1.0;

/// Looks again at frames that are beside the way, or much less like the original than the others: from where the
/// way leads, and at every moment.
pub(super) fn look_again(
    stage: &mut Stage,
    frames: &[Picture],
    fits: &mut [Fit],
    work: &mut Work<'_>,
) -> Result<(), EngineError> {
    let width = frames.first().map_or(0.0, |frame| frame.gray.width as f64);
    let apart: Vec<Option<f64>> =
        (0..fits.len()).map(|at| Some(fits[at].pose.apart_px(&between(fits, at)?, width))).collect();
    let far = APART_PX.max(APART_OF_USUAL * median(apart.iter().flatten().copied()));
    for at in 0..fits.len() {
        let beside = &fits[at.saturating_sub(BESIDE)..(at + 1 + BESIDE).min(fits.len())];
        let dear = DEAR * median(beside.iter().map(|fit| fit.cost));
        if !(fits[at].cost > dear || apart[at].is_some_and(|apart| apart > far)) {
            continue;
        }
        work.look("frames beside the way")?;
        let mut begun: Vec<Pose> = between(fits, at).into_iter().collect();
        let from = begun.first().copied().unwrap_or(fits[at].pose);
        begun.extend(moments(stage, &frames[at].gray, &from, SCANNED, 1.0)?.into_iter().take(ALIKE));
        let mut best: Option<Fit> = None;
        for pose in begun {
            let fit = align(stage, &frames[at].gray, &pose, NEXT)?;
            best = best.filter(|best| best.cost <= fit.cost).or(Some(fit));
        }
        if let Some(best) = best {
            let fit = align(stage, &frames[at].gray, &best.pose, LAST)?;
            fits[at] = if fit.cost < fits[at].cost { fit } else { fits[at] };
        }
    }
    Ok(())
}

/// Looks at the dearest frames at every moment, and where that leads elsewhere, from there at those beside them: where
/// a turn hides what moves, a shot may be followed along a wrong way whose neighbours agree. Whether any is elsewhere
/// now. `tell` is called before each.
///
/// # Errors
/// When memory runs out or the device fails, and those of `tell`.
pub fn over_all_moments(
    stage: &mut Stage,
    frames: &[Picture],
    fits: &mut [Fit],
    lens: f64,
    tell: &mut dyn FnMut() -> Result<(), EngineError>,
) -> Result<bool, EngineError> {
    let (mut looked_at, mut any) = (vec![false; fits.len()], false);
    while stage.moves() {
        let open = (0..fits.len()).filter(|at| !looked_at[*at]);
        let Some(at) = open.max_by(|a, b| fits[*a].cost.total_cmp(&fits[*b].cost)) else { break };
        tell()?;
        looked_at[at.saturating_sub(BESIDE)..(at + 1 + BESIDE).min(fits.len())].fill(true);
        let places = over_the_motion(stage, &frames[at].gray, fits[at].pose)?;
        let mut mended = false;
        for place in places.iter().take(CLOSER) {
            let fit = all_steps(stage, &frames[at].gray, &with_lens(place.pose, lens))?;
            mended |= take_better(stage, &frames[at].gray, &mut fits[at], fit)?;
        }
        // The others are where they are, too, if the dearest is.
        if !mended {
            break;
        }
        any = true;
        for way in both_ways(at, fits.len()) {
            let mended = carry(stage, frames, fits, at, &way)?;
            mended.iter().for_each(|next| looked_at[*next] = true);
            // And back: those beside it may have come closer.
            if let Some(beside) = mended.first() {
                carry(stage, frames, fits, *beside, &[at])?;
            }
        }
    }
    Ok(any)
}

/// From a frame on, frame by frame, as long as what is next to it is better than what was known; these frames.
fn carry(
    stage: &mut Stage,
    frames: &[Picture],
    fits: &mut [Fit],
    from: usize,
    way: &[usize],
) -> Result<Vec<usize>, EngineError> {
    let (mut last, mut earlier, mut mended) = (from, None::<Pose>, Vec::new());
    for &at in way {
        let frame = &frames[at].gray;
        let begun = fits[last].pose;
        if is_same(frame, &frames[last].gray) {
            fits[at] = fits[last];
        } else {
            let ahead = earlier.map_or(begun, |earlier| begun.moved(&begun.since(&earlier)));
            let there = moments(stage, frame, &ahead, SCANNED, NEAR)?.first().copied().unwrap_or(ahead);
            let near = align(stage, frame, &there, NEXT)?;
            let starts = [ahead, with_lens(near.pose, begun.lens)];
            let costs = costs_of(stage, frame, &starts, LAST)?;
            let fit = all_steps(stage, frame, &starts[usize::from(costs[1] < costs[0])])?;
            if !take_better(stage, frame, &mut fits[at], fit)? {
                break;
            }
            earlier = Some(begun);
        }
        mended.push(at);
        last = at;
    }
    Ok(mended)
}

/// A frame's last steps, as often as they help.
fn all_steps(stage: &mut Stage, frame: &Gray, begun: &Pose) -> Result<Fit, EngineError> {
    let mut fit = last_steps(stage, frame, begun)?;
    for _ in 1..ROUNDS {
        let next = last_steps(stage, frame, &fit.pose)?;
        let helps = next.cost < BETTER * fit.cost;
        fit = if next.cost < fit.cost { next } else { fit };
        if !helps {
            break;
        }
    }
    Ok(fit)
}

/// Takes another place of a frame if it fits clearly better there; whether that is elsewhere.
fn take_better(stage: &mut Stage, frame: &Gray, known: &mut Fit, other: Fit) -> Result<bool, EngineError> {
    let costs = costs_of(stage, frame, &[known.pose, other.pose], LAST)?;
    let is_better = costs[1] < BETTER * costs[0];
    let is_elsewhere = known.pose.apart_px(&other.pose, frame.width as f64) >= ELSEWHERE_PX;
    if is_better {
        *known = other;
    }
    Ok(is_better && is_elsewhere)
}

/// Between the poses of a frame's neighbours, where it has two.
fn between(fits: &[Fit], at: usize) -> Option<Pose> {
    let (before, behind) = (fits.get(at.checked_sub(1)?)?.pose, fits.get(at + 1)?.pose);
    Some(before.toward(&behind, 0.5))
}
