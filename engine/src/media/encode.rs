//! H.264 in MP4 with exact colour tags.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

use std::num::NonZeroU32;

use super::clip::FrameRate;
use super::ffmpeg::{Ffmpeg, Running, failed, file_argument, spawn};
use super::frames::Frame;
use crate::EngineError;
use crate::output::{AtomicFile, Existing};

/// What to do with an odd width or height, which 4:2:0 video cannot store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OddSize {
    /// Say so and stop.
    #[default]
    Refuse,
    /// Repeat the last column or row; the video is one pixel larger.
    Extend,
}

/// Settings of an MP4 file.
#[derive(Clone, Debug)]
pub struct EncodeOptions {
    /// Programs.
    pub ffmpeg: Ffmpeg,
    /// Frame rate.
    pub frame_rate: FrameRate,
    /// x264's constant rate factor, 0 to 51; smaller keeps more.
    pub crf: u8,
    /// What to do with odd sizes.
    pub odd_size: OddSize,
    /// What to do with a file that is there.
    pub existing: Existing,
}

impl Default for EncodeOptions {
    fn default() -> Self {
        Self {
            ffmpeg: Ffmpeg::default(),
            frame_rate: FrameRate::per_second(NonZeroU32::new(30).expect("30 is not 0")),
            crf: 12,
            odd_size: OddSize::Refuse,
            existing: Existing::Refuse,
        }
    }
}

/// The system's words for a full disk, as ffmpeg repeats them.
const DISK_FULL: &str = "No space left on device";

/// Largest crf that x264 accepts for 8-bit video.
const MAX_CRF: u8 = 51;

/// Writes frames one after the other: H.264, yuv420p, BT.709 in matrix, primaries, transfer and limited
/// range, index at the front. The file appears when it is finished.
pub struct Mp4Writer {
    program: PathBuf,
    size_px: (u32, u32),
    odd_size: OddSize,
    stdin: Option<ChildStdin>,
    running: Option<Running>,
    /// Last, so that the encoder has ended when its unfinished file is removed.
    output: AtomicFile,
}

impl Mp4Writer {
    /// Starts the encoder for frames of `size_px` = (width, height).
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if `path` exists and may not be replaced, or its place is not writable;
    /// [`EngineError::Usage`] for odd sizes (see [`OddSize`]) or a bad crf; [`EngineError::Program`] without ffmpeg.
    pub fn start(path: &Path, size_px: (u32, u32), options: &EncodeOptions) -> Result<Self, EngineError> {
        check(size_px, options)?;
        let output = AtomicFile::create(path, options.existing)?;
        let program = options.ffmpeg.ffmpeg.clone();
        let mut command = Command::new(&program);
        // Without -xerror, ffmpeg 5.1 counts a file whose end did not fit on the disk as a success.
        command.args(["-hide_banner", "-loglevel", "error", "-xerror", "-y"]);
        command.args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size"]);
        command.arg(format!("{}x{}", even(size_px.0), even(size_px.1)));
        let FrameRate { frames, seconds } = options.frame_rate;
        command.args(["-framerate", &format!("{frames}/{seconds}"), "-i", "pipe:0"]);
        command.args(["-vf", TO_BT709, "-c:v", "libx264", "-pix_fmt", "yuv420p"]);
        command.args(["-crf", &options.crf.to_string()]);
        command.args(["-colorspace", "bt709", "-color_primaries", "bt709"]);
        command.args(["-color_trc", "bt709", "-color_range", "tv"]);
        command.args(["-movflags", "+faststart", "-f", "mp4"]);
        command.arg(file_argument(output.path())).stdin(Stdio::piped());
        let mut running = spawn(&program, &mut command)?;
        let stdin = running.child.stdin.take();
        Ok(Self { program, size_px, odd_size: options.odd_size, stdin, running: Some(running), output })
    }

    /// Appends a frame.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a frame of another size, [`EngineError::Program`] if the encoder stopped.
    pub fn push(&mut self, frame: &Frame) -> Result<(), EngineError> {
        if (frame.width(), frame.height()) != self.size_px {
            return Err(EngineError::Usage {
                what: "frame to encode".to_owned(),
                got: format!("{} x {} px", frame.width(), frame.height()),
                expected: format!("{} x {} px", self.size_px.0, self.size_px.1),
            });
        }
        let written = match (&mut self.stdin, self.odd_size) {
            (Some(stdin), OddSize::Refuse) => stdin.write_all(frame.rgb()),
            (Some(stdin), OddSize::Extend) => stdin.write_all(&extended(frame)),
            (None, _) => Err(std::io::ErrorKind::BrokenPipe.into()),
        };
        written.map_err(|error| {
            self.stdin = None;
            match self.running.take().map(Running::wait) {
                Some(Ok(ended)) => self.stopped(&ended.messages),
                _ => failed(&self.program, &error.to_string()),
            }
        })
    }

    /// Closes the file.
    ///
    /// # Errors
    /// [`EngineError::Program`] with the encoder's own words if it failed; those of [`AtomicFile::commit`].
    pub fn finish(mut self) -> Result<(), EngineError> {
        self.stdin = None;
        let Some(running) = self.running.take() else {
            return Err(failed(&self.program, "the encoder had stopped"));
        };
        let ended = running.wait()?;
        if !ended.success || !ended.messages.is_empty() {
            return Err(self.stopped(&ended.messages));
        }
        self.output.commit()
    }

    /// Why the encoder gave up; a full disk is no fault of the program.
    fn stopped(&self, messages: &str) -> EngineError {
        if messages.contains(DISK_FULL) {
            let source = std::io::Error::new(std::io::ErrorKind::StorageFull, DISK_FULL);
            return EngineError::Io { path: self.output.path().to_path_buf(), source };
        }
        failed(&self.program, messages)
    }
}

/// Writes a whole clip.
///
/// # Errors
/// [`EngineError::Usage`] for no frames or frames of different sizes; those of [`Mp4Writer`].
pub fn write_mp4(path: &Path, frames: &[Frame], options: &EncodeOptions) -> Result<(), EngineError> {
    let first = frames.first().ok_or_else(|| EngineError::Usage {
        what: "frames to encode".to_owned(),
        got: "none".to_owned(),
        expected: "at least one".to_owned(),
    })?;
    let mut writer = Mp4Writer::start(path, (first.width(), first.height()), options)?;
    for frame in frames {
        writer.push(frame)?;
    }
    writer.finish()
}

/// Full-range RGB to limited-range BT.709 with exact rounding.
const TO_BT709: &str = "scale=out_color_matrix=bt709:in_range=pc:out_range=tv:\
                        flags=bicubic+accurate_rnd+full_chroma_int+full_chroma_inp,format=yuv420p";

fn check(size_px: (u32, u32), options: &EncodeOptions) -> Result<(), EngineError> {
    if options.crf > MAX_CRF {
        return Err(EngineError::Usage {
            what: "crf".to_owned(),
            got: options.crf.to_string(),
            expected: format!("0 to {MAX_CRF}"),
        });
    }
    let (width, height) = size_px;
    let is_odd = width % 2 == 1 || height % 2 == 1;
    if width == 0 || height == 0 || (is_odd && options.odd_size == OddSize::Refuse) {
        return Err(EngineError::Usage {
            what: "size of an mp4 video".to_owned(),
            got: format!("{width} x {height} px"),
            expected: "even width and height; write a PNG folder for odd sizes".to_owned(),
        });
    }
    Ok(())
}

const fn even(length: u32) -> u32 {
    length + length % 2
}

fn extended(frame: &Frame) -> Vec<u8> {
    let row_bytes = 3 * frame.width() as usize;
    let mut out = Vec::with_capacity(frame.rgb().len() + row_bytes + 3 * frame.height() as usize);
    let mut push_row = |row: &[u8]| {
        out.extend_from_slice(row);
        if frame.width() % 2 == 1 {
            out.extend_from_slice(&row[row_bytes - 3..]);
        }
    };
    frame.rgb().chunks_exact(row_bytes).for_each(&mut push_row);
    if frame.height() % 2 == 1 {
        push_row(&frame.rgb()[frame.rgb().len() - row_bytes..]);
    }
    out
}
