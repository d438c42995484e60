//! Whether a frame is found in the same place from its other side.

use super::align::align;
use super::film::{LAST, Track, apart_px, median};
use super::picture::Picture;
use super::pose::Pose;
use super::search::with_lens;
use super::stage::Stage;
use crate::error::EngineError;

/// Frames that are looked for again.
const AGAIN: usize = 5;

/// How far apart a frame is found from the frames before it and from those behind it, px, at the median of some of the
/// longest shot's; none where no frame has others behind it that are known. Both ways lead to one place where pictures
/// say where that is; where they leave it open each ends in its own (forward–backward error, Kalal et al. 2010).
///
/// `stage` draws as the film was made.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn gap_px(stage: &mut Stage, frames: &[Picture], track: &Track) -> Result<Option<f64>, EngineError> {
    let Some(shot) = track.shots.iter().max_by_key(|shot| shot.len()) else { return Ok(None) };
    let pose = |at: usize| -> Option<Pose> { Some(track.frames.get(at)?.as_ref()?.pose) };
    // A frame, and where those behind it lead.
    let from_behind = |at: usize| {
        let [here, next, then] = [at, at + 1, at + 2].map(pose);
        let (next, then) = (next?, then?);
        Some((here?, next.moved(&next.since(&then))))
    };
    let known: Vec<usize> =
        shot.clone().take(shot.len().saturating_sub(2)).filter(|at| from_behind(*at).is_some()).collect();
    let count = AGAIN.min(known.len());
    let mut gaps = Vec::new();
    for number in 0..count {
        let at = known[(2 * number + 1) * known.len() / (2 * count)];
        let Some((here, led)) = from_behind(at) else { continue };
        let frame = if track.is_mirrored { &frames[at].mirrored() } else { &frames[at] };
        let again = align(stage, &frame.gray, &with_lens(led, here.lens), LAST)?;
        gaps.push(apart_px(&again.pose, &here, frame.gray.width as f64));
    }
    Ok((!gaps.is_empty()).then(|| median(gaps.into_iter())))
}
