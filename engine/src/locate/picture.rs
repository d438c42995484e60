//! A film's frame, as it is looked at.

use super::gray::Gray;
use super::thumbnail::Thumbnail;
use crate::media::Frame;

/// A frame in one channel, which says from where it was taken, and small and in colour, for a first guess.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Luma.
    pub gray: Gray,
    /// The same frame.
    pub thumbnail: Thumbnail,
}

impl Picture {
    /// Of a frame, with sides of at most so many pixels.
    #[must_use]
    pub fn of_frame(frame: &Frame, longest_px: u32) -> Self {
        Self { gray: Gray::of_frame(frame).within(longest_px), thumbnail: Thumbnail::of_frame(frame) }
    }

    /// Left and right exchanged.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self { gray: self.gray.mirrored(), thumbnail: self.thumbnail.mirrored() }
    }
}
