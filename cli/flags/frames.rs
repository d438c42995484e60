//! Which frames of films are read, and what part of a frame is the picture.

use std::num::NonZeroU32;

use clap::Args;
use guard4d_engine::media::framing::{Crop, Framing};
use guard4d_engine::picture::undo_guess::GuessSearch;

use super::size::parse_size;

/// Which frames are read.
#[derive(Args, Debug)]
#[command(next_help_heading = "Frames")]
pub(crate) struct FrameArgs {
    /// First frame to read, counted from 0
    ///
    /// A video is decoded up to it, and what was decoded is dropped.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) start: u32,
    /// Read one of so many frames, beginning with the first
    #[arg(long, value_name = "K", default_value = "1")]
    pub(crate) every: NonZeroU32,
    /// Read no more frames than this of each clip
    #[arg(long, value_name = "N")]
    pub(crate) max_frames: Option<NonZeroU32>,
}

/// What part of a frame is the picture, and what may have been done to it.
#[derive(Args, Debug)]
#[command(next_help_heading = "Frames")]
pub(crate) struct FramingArgs {
    /// Part of every suspect frame that is the picture, in pixels, or auto, which finds bars
    ///
    /// `auto` cuts off bars of one colour, above and below or left and right, where they come in pairs of the same
    /// width and the picture begins with a straight edge; else it says that there are none. It looks at pictures alone,
    /// not at the key, so that the p-value stays what it is. Whoever tries several parts by hand has to multiply it by
    /// their number.
    #[arg(long, value_name = "X,Y,W,H|auto")]
    crop: Option<Crop>,
    /// Size that suspect pictures had before they were stretched
    ///
    /// Pictures are brought back to it. `auto` takes them as they are, which is right for nearly all: pictures of any
    /// size and shape are squashed to the square that CLIP sees, so that stretching by itself changes little.
    #[arg(long, value_name = "WIDTHxHEIGHT|auto", default_value = "auto", value_parser = PictureSize::parse)]
    picture_size: PictureSize,
    /// Guess what was done to the films, and undo it: rotation, crop, window, brightness, mirror
    ///
    /// Several kinds are undone each with each, for all films alike: 8 turns to 20 degrees either way (rotation), the
    /// middle 0.9 to 0.6 of each side (crop) or such parts from anywhere (window), 4 factors from 0.7 to 1.4
    /// (brightness), left and right swapped (mirror). What is nearest to the claim counts, and its p-value is
    /// multiplied by the number of guesses: 9 for rotation, 5 for crop, 565 for window, 5 for brightness, 2 for mirror;
    /// 45 for rotation,crop. Every frame is read as often. Name all kinds at once: whoever tries one list after the
    /// other has tried both.
    ///
    /// `auto` looks at the films first: where they are framed by what they show it guesses mirror, 2 times, and
    /// otherwise rotation,crop,mirror, 90 times.
    #[arg(long, value_name = "KIND,…")]
    undo_guess: Option<GuessSearch>,
}

impl FramingArgs {
    pub(crate) fn framing(&self) -> Framing {
        Framing { crop: self.crop.unwrap_or_default(), size_px: self.picture_size.0 }
    }

    pub(crate) fn guesses(&self) -> GuessSearch {
        self.undo_guess.clone().unwrap_or_default()
    }
}

/// Width and height in pixels; none for `auto`.
#[derive(Clone, Copy, Debug)]
struct PictureSize(Option<(u32, u32)>);

impl PictureSize {
    fn parse(text: &str) -> Result<Self, String> {
        if text == "auto" { Ok(Self(None)) } else { parse_size(text).map(|size| Self(Some(size))) }
    }
}
