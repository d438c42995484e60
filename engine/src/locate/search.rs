//! A frame of which nothing is known.

use super::align::{Detail, Fit, Plan, Way, align, moments};
use super::bank::{Bank, Edges};
use super::gray::Gray;
use super::picture::Picture;
use super::pose::{LENS, PARAMETERS, Pose};
use super::stage::{About, Stage};
use crate::error::EngineError;

/// Guesses that are looked at.
const GUESSES: usize = 8;
/// Those that are worth a closer look, and a second one.
const CLOSER: [usize; 2] = [5, 2];
/// Moments of each that are looked at closer.
const ALIKE: usize = 3;
/// The lens that a guess is looked at through, as a field of view of the longer side, degrees.
const LENS_DEG: f64 = 40.0;
/// Likeness from which on a pose is tried at other moments, too: 16 that ended well had 0.82 and more before, and 27 of
/// 36 for another asset less than this.
const LIKELY: f64 = 0.6;
/// Parts of the motion, at the ends of which a pose is fitted, and how many of these are looked at closer.
const SWEPT: f64 = 32.0;
const ALIKE_IN_SWEEP: usize = 5;

/// How much less may be known of a moment because turns hide what moves, before the last steps are exact ones: 1.2 to
/// 2.5 in films of usual views, 6 to 17 in those from above; and 3.2 to 3.8 in one of a small robot, where exact slopes
/// say 30 to 50.
pub(super) const TIED: f64 = 3.0;

/// Of pictures that moments are looked for in.
pub(super) const SCANNED: Detail = Detail::Radius(24.0);
/// Steps from coarse to fine. At first a turn by ten degrees, which is as far as views of the bank are apart, is one or
/// two pixels.
const BLURRED: Plan = Plan { detail: Detail::Radius(10.0), steps: 6, lens: false, time: true, way: Way::Small };
const COARSE: Plan = Plan { detail: Detail::Radius(16.0), steps: 8, lens: true, time: true, way: Way::Small };
const MIDDLE: Plan = Plan { detail: Detail::Radius(32.0), steps: 10, lens: true, time: true, way: Way::Small };
const SWEEP: Plan = Plan { detail: Detail::Radius(48.0), steps: 4, lens: false, time: false, way: Way::Small };
const FINE: Plan = Plan { detail: Detail::Radius(72.0), steps: 8, lens: true, time: true, way: Way::Small };

/// Steps at the end, of a frame whose place and lens are known.
pub(super) const LAST: Plan = Plan { lens: false, ..TELL };
const LAST_EXACTLY: Plan = Plan { steps: 6, way: Way::Exact, ..LAST };
/// The same for those that tell the lens.
pub(super) const TELL: Plan = Plan { detail: Detail::Width(384), steps: 8, lens: true, time: true, way: Way::AsFilm };
/// Steps for a frame whose neighbour is known.
pub(super) const NEXT: Plan = Plan { detail: Detail::Radius(40.0), steps: 5, lens: false, time: true, way: Way::Small };
/// How far its moment may be from where it is looked for: so much, and as far as that is from the last.
pub(super) const NEAR: f64 = 0.06;

const EXACT: Plan = Plan { detail: Detail::Radius(90.0), steps: 10, lens: true, time: true, way: Way::Exact };

/// Where a frame was taken, as well as can be told from it alone; none for a bank without pictures.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn anywhere(stage: &mut Stage, bank: &Bank, picture: &Picture, edges: Edges) -> Result<Option<Fit>, EngineError> {
    let frame = &picture.gray;
    let longer = frame.width.max(frame.height) as f64 / frame.width as f64;
    let usual = (longer / (2.0 * (LENS_DEG.to_radians() / 2.0).tan())).ln();
    let mut fits = Vec::new();
    for guess in bank.guesses(stage, &picture.thumbnail, edges, GUESSES)? {
        // From within a scene what stands where matters more than how large it is.
        let lens = if stage.about() == About::Seen { guess.lens_from_there() } else { usual };
        let blurred = align(stage, frame, &guess.through(lens), BLURRED)?;
        fits.push(align(stage, frame, &blurred.pose, COARSE)?);
    }
    for (count, plan) in CLOSER.into_iter().zip([MIDDLE, FINE]) {
        // What differs is less in pictures of fewer pixels, which are those of larger assets.
        fits.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
        fits.truncate(count);
        let mut closer = Vec::new();
        for fit in &fits {
            for pose in moments(stage, frame, &fit.pose, SCANNED, 1.0)?.iter().take(ALIKE) {
                closer.push(align(stage, frame, pose, plan)?);
            }
        }
        fits = closer;
    }
    match fits.into_iter().max_by(|a, b| a.correlation.total_cmp(&b.correlation)) {
        Some(best) if stage.moves() && best.correlation >= LIKELY => Ok(Some(at_any_moment(stage, frame, best)?)),
        best => Ok(best),
    }
}

/// Poses over the whole motion at which a frame fits, the best first: a turn can hide what moves, so that each moment
/// is tried with the pose that fits there, from one to the next, and those are looked at closer that fit better than
/// the ones before and after.
///
/// # Errors
/// When memory runs out or the device fails.
pub(super) fn over_the_motion(stage: &mut Stage, frame: &Gray, from: Pose) -> Result<Vec<Fit>, EngineError> {
    let here = align(stage, frame, &from, SWEEP)?;
    let mut before = onward(stage, frame, here.pose, -1.0)?;
    before.reverse();
    let all: Vec<Fit> = before.into_iter().chain([here]).chain(onward(stage, frame, here.pose, 1.0)?).collect();
    let beside = |at: Option<usize>| at.and_then(|at| all.get(at)).map_or(f64::INFINITY, |fit| fit.cost);
    let is_least = |at: &usize| all[*at].cost <= beside(at.checked_sub(1)).min(beside(at.checked_add(1)));
    let mut fits: Vec<Fit> = (0..all.len()).filter(is_least).map(|at| all[at]).collect();
    fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    fits.truncate(ALIKE_IN_SWEEP);
    for fit in &mut fits {
        *fit = align(stage, frame, &fit.pose, FINE)?;
    }
    fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Ok(fits)
}

/// Where a frame fits at each moment from a pose's on, later ones or earlier.
fn onward(stage: &mut Stage, frame: &Gray, from: Pose, way: f64) -> Result<Vec<Fit>, EngineError> {
    let (mut pose, mut fits) = (from, Vec::new());
    loop {
        let time = pose.time + way / SWEPT;
        if !(0.0..=1.0).contains(&time) {
            return Ok(fits);
        }
        let fit = align(stage, frame, &Pose { time, ..pose }, SWEEP)?;
        pose = fit.pose;
        fits.push(fit);
    }
}

/// A fit, or a better one at another moment.
fn at_any_moment(stage: &mut Stage, frame: &Gray, best: Fit) -> Result<Fit, EngineError> {
    let other = over_the_motion(stage, frame, best.pose)?.into_iter().next();
    let best = other.filter(|other| other.cost < best.cost).unwrap_or(best);
    if best.tied <= TIED {
        return Ok(best);
    }
    let exact = align(stage, frame, &best.pose, EXACT)?;
    // Both are compared with others, of other frames, by what is alike at the same size.
    Ok(Fit { pose: exact.pose, ..best })
}

/// A frame's last steps: exact ones where a turn hides what moves.
///
/// # Errors
/// When memory runs out or the device fails.
pub(super) fn last_steps(stage: &mut Stage, frame: &Gray, begun: &Pose) -> Result<Fit, EngineError> {
    let fit = align(stage, frame, begun, LAST)?;
    if fit.tied > TIED { align(stage, frame, &fit.pose, LAST_EXACTLY) } else { Ok(fit) }
}

/// The same picture through another lens: as large, from another distance.
#[must_use]
pub fn with_lens(pose: Pose, lens: f64) -> Pose {
    let mut step = [0.0; PARAMETERS];
    step[LENS] = lens - pose.lens;
    pose.moved(&step)
}
