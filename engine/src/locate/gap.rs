//! Whether a frame is found in the same place from its other side.

use super::align::align;
use super::film::Track;
use super::picture::Picture;
use super::pose::Pose;
use super::search::{LAST, with_lens};
use super::stage::Stage;
use crate::base::numbers::median;
use crate::base::spread::spread;
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
    let from_behind = |at: usize| {
        let [here, next, then] = [at, at + 1, at + 2].map(pose);
        let (next, then) = (next?, then?);
        Some(Led { at, here: here?, led: next.moved(&next.since(&then)) })
    };
    let within = shot.clone().take(shot.len().saturating_sub(2));
    let known: Vec<Led> = within.filter_map(from_behind).collect();
    let mut gaps = Vec::new();
    for Led { at, here, led } in spread(known.len(), AGAIN).map(|number| known[number]) {
        let frame = if track.is_mirrored { &frames[at].mirrored() } else { &frames[at] };
        let again = align(stage, &frame.gray, &with_lens(led, here.lens), LAST)?;
        gaps.push(again.pose.apart_px(&here, frame.gray.width as f64));
    }
    Ok((!gaps.is_empty()).then(|| median(gaps.into_iter())))
}

/// A frame, where it was found, and where those behind it lead.
#[derive(Clone, Copy)]
struct Led {
    at: usize,
    here: Pose,
    led: Pose,
}
