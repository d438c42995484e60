//! A film from its first frame to its last.

use guard4d_kernels::Device;

use super::align::{Fit, Plan, align, moments};
use super::bank::Bank;
use super::gray::Gray;
use super::pose::{PARAMETERS, Pose};
use super::stage::Stage;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::{Camera, FrameSize, Model};

/// Guesses at a frame of which nothing is known.
const GUESSES: usize = 10;
/// Those that are worth a closer look, and a second one.
const CLOSER: [usize; 2] = [4, 2];
/// Moments of each that are looked at closer.
const ALIKE: usize = 3;
/// The lens that a guess is looked at through, as a horizontal field of view, degrees.
const LENS_DEG: f64 = 45.0;
/// Likeness from which on a frame is found.
const FOUND: f64 = 0.6;
/// Likeness that needs no second look.
const GOOD: f64 = 0.85;
/// Likeness of a frame, of its neighbour's, under which it is looked for anew; and how often that is done.
const LOST: f64 = 0.8;
const SEARCHES: u32 = 4;
/// Frames of which nothing is known that are looked for before the film is given up.
const TRIES: usize = 5;

/// Width of pictures that moments are looked for in, px, and how far the next frame's may be.
const SCANNED_PX: u32 = 64;
const NEAR: f64 = 0.08;
/// Steps from coarse to fine for a frame of which nothing is known.
const COARSE: Plan = Plan { width_px: 48, steps: 8, lens: false };
const MIDDLE: Plan = Plan { width_px: 96, steps: 10, lens: true };
const FINE: Plan = Plan { width_px: 192, steps: 8, lens: true };
/// For one whose neighbour is known.
const NEXT: Plan = Plan { width_px: 128, steps: 5, lens: false };
/// For all, from the lens that most have.
const LAST: Plan = Plan { width_px: 384, steps: 5, lens: true };

/// Where a frame was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// The camera, of the frame's size.
    pub camera: Camera,
    /// The moment, 0 to 1.
    pub time: f32,
    /// How alike the gradients of frame and asset are, −1 to 1.
    pub likeness: f64,
}

/// What watches.
pub type Watch<'a> = dyn FnMut(u64, u64) -> Result<(), EngineError> + 'a;

/// Finds the cameras of frames in sequence; none where the asset is not found in them. `watch` is told of work done and
/// of all there is.
///
/// # Errors
/// When memory runs out, the device fails, or `watch` does.
pub fn locate(
    device: &Device,
    model: &Model,
    frames: &[Gray],
    watch: &mut Watch<'_>,
) -> Result<Option<Vec<Located>>, EngineError> {
    let mut stage = Stage::new(device, model)?;
    let bank = Bank::new(&mut stage)?;
    let total = 2 * frames.len() as u64;
    let mut fits: Vec<Option<Fit>> = vec![None; frames.len()];
    let Some(start) = first(&mut stage, &bank, frames, &mut fits)? else { return Ok(None) };
    let (mut done, mut searches) = (1, SEARCHES);
    let forward: Vec<usize> = (start + 1..frames.len()).collect();
    let backward: Vec<usize> = (0..start).rev().collect();
    for way in [forward, backward] {
        let mut before = [fits[start], None];
        for at in way {
            watch(done, total)?;
            let fit = next(&mut stage, &bank, &frames[at], before, &mut searches)?;
            fits[at] = Some(fit);
            before = [Some(fit), before[0]];
            done += 1;
        }
    }
    let fits: Vec<Fit> = fits.into_iter().flatten().collect();
    stage.set_rough(false);
    let lens = median(fits.iter().map(|fit| fit.pose.lens));
    let mut located = Vec::new();
    for (frame, fit) in frames.iter().zip(&fits) {
        watch(done, total)?;
        done += 1;
        let Fit { pose, correlation, .. } = align(&mut stage, frame, &with_lens(fit.pose, lens), LAST)?;
        let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
        let camera = pose.camera(stage.middle(), FrameSize::new(side(frame.width), side(frame.height))?);
        located.push(Located { camera, time: narrow(pose.time), likeness: correlation });
    }
    let is_found = median(located.iter().map(|located| located.likeness)) >= FOUND;
    Ok(is_found.then_some(located))
}

/// Looks for the asset in a few frames until it is found in one.
fn first(
    stage: &mut Stage,
    bank: &Bank,
    frames: &[Gray],
    fits: &mut [Option<Fit>],
) -> Result<Option<usize>, EngineError> {
    let mut best: Option<usize> = None;
    for number in 0..TRIES.min(frames.len()) {
        let at = (2 * number + 1) * frames.len() / (2 * TRIES.min(frames.len()));
        let fit = anywhere(stage, bank, &frames[at])?;
        fits[at] = fit;
        let likeness = |at: usize| fits[at].map_or(f64::NEG_INFINITY, |fit| fit.correlation);
        if best.is_none_or(|best| likeness(at) > likeness(best)) {
            best = Some(at);
        }
        if likeness(at) >= GOOD {
            break;
        }
    }
    Ok(best.filter(|at| fits[*at].is_some_and(|fit| fit.correlation >= FOUND)))
}

/// A frame of which nothing is known.
fn anywhere(stage: &mut Stage, bank: &Bank, frame: &Gray) -> Result<Option<Fit>, EngineError> {
    let mut fits = Vec::new();
    for guess in bank.guesses(frame, GUESSES) {
        let lens = -(2.0 * (LENS_DEG.to_radians() / 2.0).tan()).ln();
        fits.push(align(stage, frame, &with_lens(guess.pose, lens), COARSE)?);
    }
    for (count, plan) in CLOSER.into_iter().zip([MIDDLE, FINE]) {
        fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        fits.truncate(count);
        let mut closer = Vec::new();
        for fit in &fits {
            for pose in moments(stage, frame, &fit.pose, SCANNED_PX, 1.0)?.iter().take(ALIKE) {
                closer.push(align(stage, frame, pose, plan)?);
            }
        }
        fits = closer;
    }
    Ok(fits.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost)))
}

/// A frame beside one that is known: from there, from where the last step leads, or from anywhere if it is not there.
fn next(
    stage: &mut Stage,
    bank: &Bank,
    frame: &Gray,
    before: [Option<Fit>; 2],
    searches: &mut u32,
) -> Result<Fit, EngineError> {
    let [Some(last), earlier] = before else { unreachable!("the way begins at a frame that is known") };
    let ahead = earlier.map(|earlier| last.pose.moved(&last.pose.since(&earlier.pose)));
    let mut best: Option<Fit> = None;
    for begun in ahead.into_iter().chain([last.pose]) {
        let pose = moments(stage, frame, &begun, SCANNED_PX, NEAR)?.first().copied().unwrap_or(begun);
        let fit = align(stage, frame, &pose, NEXT)?;
        if best.is_none_or(|best| fit.correlation > best.correlation) {
            best = Some(fit);
        }
        if fit.correlation >= 0.9 * last.correlation {
            break;
        }
    }
    let best = best.expect("it began somewhere");
    if best.correlation >= FOUND.max(LOST * last.correlation) || *searches == 0 {
        return Ok(best);
    }
    *searches -= 1;
    Ok(anywhere(stage, bank, frame)?.filter(|fit| fit.correlation > best.correlation).unwrap_or(best))
}

/// The same picture through another lens: as large, from another distance.
fn with_lens(pose: Pose, lens: f64) -> Pose {
    let mut step = [0.0; PARAMETERS];
    step[super::pose::LENS] = lens - pose.lens;
    pose.moved(&step)
}

/// The middle one; 0 of none.
fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.collect();
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(0.0)
}
