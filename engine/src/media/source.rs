//! Frames of a folder of pictures or a video, one after the other.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use super::decode::{self, Stream};
use super::folder::{list_pictures, read_picture};
use super::frames::{Frame, FrameRate, Integrity};
use super::framing::{BarFinder, Crop, Rect};
use super::options::ReadOptions;
use crate::error::EngineError;

/// Frames that are looked at for bars, spread over the clip.
const BAR_SAMPLES: u32 = 16;

/// What is known of a clip when its frames have been read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ending {
    /// Frames handed over; at least one.
    pub frames: u64,
    /// Width and height of the frames in pixels: without what is cut off, before any resizing.
    pub size_px: (u32, u32),
    /// Frame rate that a video declares.
    pub frame_rate: Option<FrameRate>,
    /// Whether decoding went without complaint.
    pub integrity: Integrity,
}

/// A folder of pictures or a video, whose frames can be read any number of times. Only one is in memory at a time.
#[derive(Debug)]
pub struct FrameSource {
    path: PathBuf,
    options: ReadOptions,
    kind: Kind,
    cut: Option<Rect>,
}

#[derive(Debug)]
enum Kind {
    /// All pictures of the folder.
    Folder(Vec<PathBuf>),
    Video(Box<Stream>),
}

impl FrameSource {
    /// Looks at a folder of pictures or, through ffprobe, at a video file. [`Crop::Auto`] reads some frames of it.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] for a missing path; [`EngineError::BadData`] for a folder without pictures of one
    /// kind and a file without a video stream; [`EngineError::Program`] without ffmpeg; those of [`Self::for_each`] for
    /// [`Crop::Auto`].
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self, EngineError> {
        let kind = if path.is_dir() {
            Kind::Folder(list_pictures(path)?)
        } else if path.is_file() {
            Kind::Video(Box::new(decode::probe(path, &options.ffmpeg)?))
        } else {
            return Err(EngineError::MissingInput {
                path: path.to_path_buf(),
                expected: "a folder of PNG, JPEG or OpenEXR frames, or a video file".to_owned(),
            });
        };
        let mut source = Self { path: path.to_path_buf(), options: options.clone(), kind, cut: None };
        source.cut = match options.framing.crop {
            Crop::Whole => None,
            Crop::Region(rect) => Some(rect),
            Crop::Auto => source.without_bars()?,
        };
        Ok(source)
    }

    /// What is kept of every frame, if not all of it.
    #[must_use]
    pub const fn cut(&self) -> Option<Rect> {
        self.cut
    }

    /// How many frames will be read, if the folder or the container says so. A container may be wrong.
    #[must_use]
    pub fn expected_frames(&self) -> Option<u64> {
        let total = match &self.kind {
            Kind::Folder(files) => Some(files.len() as u64),
            Kind::Video(stream) => stream.num_frames(),
        };
        total.map(|total| self.options.count(total))
    }

    /// Width and height of the frames that [`Self::for_each`] hands over; reads one.
    ///
    /// # Errors
    /// Those of [`Self::for_each`].
    pub fn size_px(&self) -> Result<(u32, u32), EngineError> {
        let mut size = (0, 0);
        let options = ReadOptions { max_frames: Some(NonZeroU32::MIN), ..self.options.clone() };
        self.read(&options, &mut |frame| {
            let frame = self.framed(frame)?;
            size = (frame.width(), frame.height());
            Ok(())
        })?;
        Ok(size)
    }

    /// Hands over frame after frame.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a clip without frames where they were looked for, for frames of different sizes and
    /// for anything undecodable; [`EngineError::Usage`] for a part of frames that is not inside;
    /// [`EngineError::Program`] without ffmpeg; and whatever `each` returns, which stops the reading.
    pub fn for_each(&self, each: &mut dyn FnMut(Frame) -> Result<(), EngineError>) -> Result<Ending, EngineError> {
        let mut ending = self.read(&self.options, &mut |frame| each(self.framed(frame)?))?;
        if let Some(Rect { width, height, .. }) = self.cut {
            ending.size_px = (width, height);
        }
        Ok(ending)
    }

    /// The picture in a frame.
    fn framed(&self, frame: Frame) -> Result<Frame, EngineError> {
        let frame = match self.cut {
            Some(rect) => frame.cut(rect)?,
            None => frame,
        };
        match self.options.framing.size_px {
            Some(size) if size != (frame.width(), frame.height()) => frame.resized(size),
            _ => Ok(frame),
        }
    }

    /// The picture between bars, if there are any.
    fn without_bars(&self) -> Result<Option<Rect>, EngineError> {
        let stride = self.expected_frames().unwrap_or(0).div_ceil(u64::from(BAR_SAMPLES));
        let stride = u64::from(self.options.every.get()).saturating_mul(stride.max(1));
        let options = ReadOptions {
            every: u32::try_from(stride).ok().and_then(NonZeroU32::new).unwrap_or(NonZeroU32::MAX),
            max_frames: NonZeroU32::new(BAR_SAMPLES),
            ..self.options.clone()
        };
        let mut finder = BarFinder::default();
        self.read(&options, &mut |frame| {
            finder.look(&frame);
            Ok(())
        })?;
        let found = finder.find();
        if found.is_none() {
            let path = self.path.display();
            tracing::warn!(%path, "no bars found; whole frames are read (--crop X,Y,W,H cuts by hand)");
        }
        Ok(found)
    }

    /// Hands over frames as they are stored.
    fn read(
        &self,
        options: &ReadOptions,
        each: &mut dyn FnMut(Frame) -> Result<(), EngineError>,
    ) -> Result<Ending, EngineError> {
        let mut first = None;
        let mut frames = 0;
        let mut take = |frame: Frame, file: &Path| {
            let size = (frame.width(), frame.height());
            let expected = *first.get_or_insert(size);
            if size != expected {
                return Err(EngineError::BadData {
                    path: file.to_path_buf(),
                    field: format!("size of frame {frames}"),
                    got: format!("{} x {} px", size.0, size.1),
                    expected: format!("{} x {} px, the size of frame 0", expected.0, expected.1),
                });
            }
            frames += 1;
            each(frame)
        };
        let (frame_rate, integrity) = match &self.kind {
            Kind::Folder(files) => {
                let most = options.max_frames.map_or(usize::MAX, |n| n.get() as usize);
                let wanted = files.iter().skip(options.start as usize).step_by(options.every.get() as usize);
                for file in wanted.take(most) {
                    take(read_picture(file, options.background, &options.ffmpeg)?, file)?;
                }
                (None, Integrity::Intact)
            }
            Kind::Video(stream) => {
                decode::for_each_frame(&self.path, stream, options, &mut |frame| take(frame, &self.path))?
            }
        };
        let size_px = first.ok_or_else(|| EngineError::BadData {
            path: self.path.clone(),
            field: "frames".to_owned(),
            got: format!("none from number {} on", options.start),
            expected: "at least one".to_owned(),
        })?;
        Ok(Ending { frames, size_px, frame_rate, integrity })
    }
}
