//! How videos and folders of pictures are read.

use std::num::NonZeroU32;

use super::ffmpeg::Ffmpeg;
use super::framing::Framing;

/// How to read a clip.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// Programs for video files.
    pub ffmpeg: Ffmpeg,
    /// Colour behind transparent pixels.
    pub background: [u8; 3],
    /// First frame to read, counted from 0. Frames of a video before it are decoded, as others need them, and dropped
    /// at once.
    pub start: u32,
    /// One of so many frames is read, beginning with the first.
    pub every: NonZeroU32,
    /// Most frames to read; none reads all.
    pub max_frames: Option<NonZeroU32>,
    /// Most bytes of decoded samples that a [`Clip`](super::clip::Clip) holds; those who take frames one after the
    /// other hold what they like.
    pub max_bytes: u64,
    /// What part of the frames is the picture.
    pub framing: Framing,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            ffmpeg: Ffmpeg::default(),
            background: [0; 3],
            start: 0,
            every: NonZeroU32::MIN,
            max_frames: None,
            max_bytes: 4 << 30,
            framing: Framing::default(),
        }
    }
}

impl ReadOptions {
    /// How many of `total` frames are read.
    pub(super) fn count(&self, total: u64) -> u64 {
        let count = total.saturating_sub(u64::from(self.start)).div_ceil(u64::from(self.every.get()));
        self.max_frames.map_or(count, |most| count.min(u64::from(most.get())))
    }
}
