//! What is looked at of a film: so many of its frames, not too large, without bars.

use std::iter;
use std::num::NonZeroU32;
use std::path::Path;

use super::picture::Picture;
use crate::base::digest::Digest;
use crate::error::EngineError;
use crate::media::framing::{BarFinder, Rect};
use crate::media::{FrameSource, ReadOptions};
use crate::scene::FrameSize;

/// The longer side of pictures, px: beyond it they say no more of cameras.
const LONGEST_PX: u32 = 768;
/// The least side, px: in fewer pixels than a camera and an exposure have numbers anything can be found.
const SHORTEST_PX: usize = 24;

/// Frames of a film.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// What is compared, in sequence; none of frames that are too small to say where they were taken.
    pub pictures: Vec<Picture>,
    /// One of so many frames is looked at, from the first on.
    pub every: usize,
    /// How many there are.
    pub frames: usize,
    /// Their size.
    pub size: FrameSize,
    /// What part of them is the picture.
    pub picture: Rect,
}

impl Reading {
    /// Reads at most so many frames, evenly spread over the film. `each` is called before each.
    ///
    /// # Errors
    /// Those of reading, and of `each`.
    pub fn of(
        path: &Path,
        options: &ReadOptions,
        most: NonZeroU32,
        each: &mut dyn FnMut() -> Result<(), EngineError>,
    ) -> Result<Self, EngineError> {
        let source = FrameSource::open(path, options)?;
        let frames = match source.expected_frames() {
            Some(frames) => frames,
            None => source.for_each(&mut |_| each())?.frames,
        };
        let every = u32::try_from(frames.div_ceil(u64::from(most.get()))).ok().and_then(NonZeroU32::new);
        let every = every.unwrap_or(NonZeroU32::MIN);
        let mut bars = BarFinder::default();
        let mut whole = Vec::new();
        let mut size_px = (1, 1);
        let mut count = 0;
        source.for_each(&mut |frame| {
            each()?;
            if count % every.get() as usize == 0 {
                size_px = (frame.width(), frame.height());
                bars.look(&frame);
                whole.push(Picture::of_frame(&frame, LONGEST_PX));
            }
            count += 1;
            Ok(())
        })?;
        let size = FrameSize::new(size_px.0, size_px.1)?;
        let all = Rect { x: 0, y: 0, width: size.width(), height: size.height() };
        let picture = bars.find().map_or(all, |inside| centred(inside, size));
        let mut pictures = match picture == all {
            true => whole,
            false => whole.iter().map(|frame| frame.cut(|sides| part(picture, size, sides))).collect(),
        };
        pictures.retain(|picture| picture.gray.width.min(picture.gray.height) >= SHORTEST_PX);
        Ok(Self { pictures, every: every.get() as usize, frames: count, size, picture })
    }

    /// Hash of the pictures.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let channels =
            self.pictures.iter().flat_map(|Picture { gray, thumbnail }| iter::once(gray).chain(&thumbnail.channels));
        let values = channels.flat_map(|channel| &channel.values);
        Digest::of(&values.flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())
    }
}

/// As much of a frame about its middle as has no bars on either side. A letterbox has bars of one height; what is black
/// beyond that is a background, and a picture that was cut to the asset would have its middle elsewhere.
fn centred(inside: Rect, size: FrameSize) -> Rect {
    let bar = |before: u32, length: u32, side: u32| before.min(side - before - length);
    let (x, y) = (bar(inside.x, inside.width, size.width()), bar(inside.y, inside.height, size.height()));
    Rect { x, y, width: size.width() - 2 * x, height: size.height() - 2 * y }
}

/// A part of frames in a picture of them that may be smaller.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "pixels within a frame")]
fn part(rect: Rect, size: FrameSize, sides: [usize; 2]) -> Rect {
    let scale = sides[0] as f64 / f64::from(size.width());
    let [x, y] = [rect.x, rect.y].map(|at| (f64::from(at) * scale).round() as u32);
    let within = |from: u32, length: u32, side: usize| {
        let length = (f64::from(length) * scale).round().max(1.0) as u32;
        length.min(u32::try_from(side).unwrap_or(u32::MAX) - from)
    };
    Rect { x, y, width: within(x, rect.width, sides[0]), height: within(y, rect.height, sides[1]) }
}
