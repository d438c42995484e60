//! What is looked at of a film: so many of its frames, not too large, without bars.

use std::iter;
use std::num::NonZeroU32;
use std::path::Path;

use super::picture::Picture;
use crate::base::digest::Digest;
use crate::error::EngineError;
use crate::media::framing::{BarFinder, Rect};
use crate::media::{Frame, FrameSource, ReadOptions};
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
    /// Reads at most so many frames, evenly spread over the film; a film with bars twice. `each` is called before each.
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
        let mut pictures = Vec::new();
        let mut size_px = (1, 1);
        let mut pass = |look: &mut dyn FnMut(&Frame) -> Result<(), EngineError>| {
            let mut count = 0;
            source.for_each(&mut |frame| {
                each()?;
                if count % every.get() as usize == 0 {
                    look(&frame)?;
                }
                count += 1;
                Ok(())
            })?;
            Ok::<_, EngineError>(count)
        };
        let frames = pass(&mut |frame| {
            size_px = (frame.width(), frame.height());
            bars.look(frame);
            pictures.push(Picture::of_frame(frame, LONGEST_PX));
            Ok(())
        })?;
        let size = FrameSize::new(size_px.0, size_px.1)?;
        let all = Rect { x: 0, y: 0, width: size.width(), height: size.height() };
        let picture = bars.middle().unwrap_or(all);
        if picture != all {
            // Cut off before they are made smaller: a pixel of those is not one of the film's.
            pictures.clear();
            pass(&mut |frame| {
                pictures.push(Picture::of_frame(&frame.cut(picture)?, LONGEST_PX));
                Ok(())
            })?;
        }
        pictures.retain(|picture| picture.gray.width.min(picture.gray.height) >= SHORTEST_PX);
        Ok(Self { pictures, every: every.get() as usize, frames, size, picture })
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
