//! A clip in memory: frames of one size from a folder of pictures or a video file.

use std::path::Path;

use super::frames::{Frame, FrameRate, Integrity};
use super::options::ReadOptions;
use super::source::{Ending, FrameSource};
use crate::base::digest::Digest;
use crate::error::EngineError;

/// Frames of one size; at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clip {
    frames: Vec<Frame>,
    frame_rate: Option<FrameRate>,
    integrity: Integrity,
}

impl Clip {
    /// Takes frames that were rendered here, such as a control's clean render.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for no frames or frames of different sizes.
    pub fn from_frames(frames: Vec<Frame>) -> Result<Self, EngineError> {
        let size = |f: &Frame| (f.width(), f.height());
        if frames.is_empty() || frames.iter().any(|f| size(f) != size(&frames[0])) {
            return Err(EngineError::Usage {
                what: "frames of a clip".to_owned(),
                got: if frames.is_empty() { "none" } else { "different sizes" }.to_owned(),
                expected: "at least one, all of one size".to_owned(),
            });
        }
        Ok(Self { frames, frame_rate: None, integrity: Integrity::Intact })
    }

    /// Frames in time order.
    #[must_use]
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// Frame rate a video declares.
    #[must_use]
    pub const fn frame_rate(&self) -> Option<FrameRate> {
        self.frame_rate
    }

    /// Whether decoding went without complaint.
    #[must_use]
    pub const fn integrity(&self) -> &Integrity {
        &self.integrity
    }

    /// Width and height in pixels.
    #[must_use]
    pub fn size_px(&self) -> (u32, u32) {
        (self.frames[0].width(), self.frames[0].height())
    }

    /// Hash of size, count and decoded samples: the same for a PNG folder and a lossless video of it.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let (width, height) = self.size_px();
        let mut hasher = blake3::Hasher::new();
        hasher.update(&width.to_le_bytes());
        hasher.update(&height.to_le_bytes());
        hasher.update(&(self.frames.len() as u64).to_le_bytes());
        for frame in &self.frames {
            hasher.update(frame.rgb());
        }
        Digest::from_bytes(*hasher.finalize().as_bytes())
    }
}

/// Reads a folder of pictures or, through ffmpeg, a video file. All frames are kept; for long videos, see
/// [`FrameSource`].
///
/// # Errors
/// Those of [`FrameSource`]; [`EngineError::Usage`] if the frames exceed `max_bytes`.
pub fn read_clip(path: &Path, options: &ReadOptions) -> Result<Clip, EngineError> {
    let source = FrameSource::open(path, options)?;
    let mut frames = Vec::new();
    let mut num_bytes = 0;
    let Ending { frame_rate, integrity, .. } = source.for_each(&mut |frame| {
        num_bytes += frame.rgb().len() as u64;
        if num_bytes > options.max_bytes {
            return Err(EngineError::Usage {
                what: format!("clip {}", path.display()),
                got: format!("more than {} MiB of frames", options.max_bytes >> 20),
                expected: "fewer frames (limit their number) or a larger memory limit".to_owned(),
            });
        }
        frames.push(frame);
        Ok(())
    })?;
    Ok(Clip { frames, frame_rate, integrity })
}
