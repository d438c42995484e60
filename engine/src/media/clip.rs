//! A clip to verify: frames of one size from a PNG folder or a video file.

use std::num::NonZeroU32;
use std::path::Path;

use super::decode;
use super::ffmpeg::Ffmpeg;
use super::frames::{Frame, list_png_folder, read_png};
use crate::EngineError;
use crate::watermark::digest::Digest;

/// Whether a video decoded without complaint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Integrity {
    /// It did, or the source was a PNG folder.
    Intact,
    /// The decoder reported errors and went on; frames may be concealed or missing.
    Damaged {
        /// The decoder's own words.
        messages: String,
    },
}

/// Frames per second as a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRate {
    /// Frames.
    pub frames: NonZeroU32,
    /// Per this many seconds.
    pub seconds: NonZeroU32,
}

impl FrameRate {
    /// Whole frames per second.
    #[must_use]
    pub const fn per_second(frames: NonZeroU32) -> Self {
        Self { frames, seconds: NonZeroU32::MIN }
    }
}

/// Frames of one size; at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Clip {
    frames: Vec<Frame>,
    frame_rate: Option<FrameRate>,
    integrity: Integrity,
}

impl Clip {
    /// Takes frames that were rendered here, such as a null panel's clean render.
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

/// How to read a clip.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// Programs for video files.
    pub ffmpeg: Ffmpeg,
    /// Colour behind transparent pixels.
    pub background: [u8; 3],
    /// Frames to read from the start; none reads all.
    pub max_frames: Option<NonZeroU32>,
    /// Most bytes of decoded samples to hold.
    pub max_bytes: u64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { ffmpeg: Ffmpeg::default(), background: [0; 3], max_frames: None, max_bytes: 4 << 30 }
    }
}

/// Reads a folder of PNG frames or, through ffmpeg, a video file.
///
/// # Errors
/// [`EngineError::MissingInput`] for a missing path; [`EngineError::BadData`] for a folder or video without
/// frames, for frames of different sizes and for anything undecodable; [`EngineError::Program`] without ffmpeg;
/// [`EngineError::Usage`] if the frames exceed `max_bytes`.
pub fn read_clip(path: &Path, options: &ReadOptions) -> Result<Clip, EngineError> {
    let mut collector = Collector::new(path, options);
    if path.is_dir() {
        let limit = options.max_frames.map_or(usize::MAX, |n| n.get() as usize);
        for file in list_png_folder(path)?.iter().take(limit) {
            collector.push(read_png(file, options.background)?, file)?;
        }
        return collector.finish(None, Integrity::Intact);
    }
    if !path.is_file() {
        return Err(EngineError::MissingInput {
            path: path.to_path_buf(),
            expected: "a folder of PNG frames or a video file".to_owned(),
        });
    }
    let (frame_rate, integrity) = decode::for_each_frame(path, options, &mut |frame| collector.push(frame, path))?;
    collector.finish(frame_rate, integrity)
}

struct Collector<'a> {
    path: &'a Path,
    max_bytes: u64,
    num_bytes: u64,
    frames: Vec<Frame>,
}

impl<'a> Collector<'a> {
    const fn new(path: &'a Path, options: &ReadOptions) -> Self {
        Self { path, max_bytes: options.max_bytes, num_bytes: 0, frames: Vec::new() }
    }

    fn push(&mut self, frame: Frame, file: &Path) -> Result<(), EngineError> {
        let size = |f: &Frame| format!("{} x {} px", f.width(), f.height());
        if let Some(first) = self.frames.first()
            && size(first) != size(&frame)
        {
            return Err(EngineError::BadData {
                path: file.to_path_buf(),
                field: format!("size of frame {}", self.frames.len()),
                got: size(&frame),
                expected: format!("{}, the size of frame 0", size(first)),
            });
        }
        self.num_bytes += frame.rgb().len() as u64;
        if self.num_bytes > self.max_bytes {
            return Err(EngineError::Usage {
                what: format!("clip {}", self.path.display()),
                got: format!("more than {} MiB of frames", self.max_bytes >> 20),
                expected: "fewer frames (limit their number) or a larger memory limit".to_owned(),
            });
        }
        self.frames.push(frame);
        Ok(())
    }

    fn finish(self, frame_rate: Option<FrameRate>, integrity: Integrity) -> Result<Clip, EngineError> {
        if self.frames.is_empty() {
            return Err(EngineError::BadData {
                path: self.path.to_path_buf(),
                field: "frames".to_owned(),
                got: "none".to_owned(),
                expected: "at least one".to_owned(),
            });
        }
        Ok(Clip { frames: self.frames, frame_rate, integrity })
    }
}
