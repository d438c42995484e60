//! Frames as video files, with exact colour tags.

use std::io::Write as _;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

use super::codec::{Codec, Container};
use super::ffmpeg::{Ffmpeg, Running, failed, file_argument, spawn};
use super::frames::{Frame, FrameRate};
use crate::base::output::{AtomicFile, Existing};
use crate::error::EngineError;

/// What to do with an odd width or height, which 4:2:0 video cannot store.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OddSize {
    /// Say so and stop.
    #[default]
    Refuse,
    /// Repeat the last column or row; the video is one pixel larger.
    Extend,
}

/// Settings of a video file.
#[derive(Clone, Debug)]
pub struct EncodeOptions {
    /// Programs.
    pub ffmpeg: Ffmpeg,
    /// Frame rate.
    pub frame_rate: FrameRate,
    /// Codec; none takes [`Container::default_codec`].
    pub codec: Option<Codec>,
    /// Constant rate factor, 0 to [`Codec::max_crf`], smaller keeps more; none takes [`Codec::default_crf`].
    pub crf: Option<u8>,
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
            codec: None,
            crf: None,
            odd_size: OddSize::Refuse,
            existing: Existing::Refuse,
        }
    }
}

/// The system's words for a full disk, as ffmpeg repeats them.
const DISK_FULL: &str = "No space left on device";

/// Writes frames one after the other. All but FFV1: yuv420p, BT.709 in matrix, primaries, transfer and limited range;
/// FFV1: the frames as they are. MP4 and MOV have their index at the front. The file appears when it is finished.
pub struct VideoWriter {
    program: PathBuf,
    size_px: (u32, u32),
    extends: bool,
    stdin: Option<ChildStdin>,
    running: Option<Running>,
    /// Last, so that the encoder has ended when its unfinished file is removed.
    output: AtomicFile,
}

impl VideoWriter {
    /// Starts the encoder for frames of `size_px` = (width, height). The extension of `path` says which container.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if `path` exists and may not be replaced, or its place is not writable;
    /// [`EngineError::Usage`] for another extension, a codec that its container does not hold, odd sizes (see
    /// [`OddSize`]) or a bad crf; [`EngineError::Program`] without ffmpeg, or if it lacks the encoder.
    pub fn start(path: &Path, size_px: (u32, u32), options: &EncodeOptions) -> Result<Self, EngineError> {
        let (container, codec, crf) = format(path, options)?;
        check_size(size_px, codec, options.odd_size)?;
        let output = AtomicFile::create(path, options.existing)?;
        let program = options.ffmpeg.ffmpeg.clone();
        let encoder = codec.encoder(&options.ffmpeg)?;
        let extends = options.odd_size == OddSize::Extend && !codec.is_lossless();
        let side = |length| if extends { even(length) } else { length };
        let mut command = Command::new(&program);
        // Without -xerror, ffmpeg 5.1 counts a file whose end did not fit on the disk as a success.
        command.args(["-hide_banner", "-loglevel", "error", "-xerror", "-y"]);
        command.args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size"]);
        command.arg(format!("{}x{}", side(size_px.0), side(size_px.1)));
        let FrameRate { frames, seconds } = options.frame_rate;
        command.args(["-framerate", &format!("{frames}/{seconds}"), "-i", "pipe:0", "-c:v", encoder]);
        command.args(Codec::arguments(encoder));
        match crf {
            Some(crf) => {
                command.args(["-crf", &crf.to_string(), "-vf", TO_BT709, "-pix_fmt", "yuv420p"]);
                command.args(["-colorspace", "bt709", "-color_primaries", "bt709"]);
                command.args(["-color_trc", "bt709", "-color_range", "tv"]);
            }
            // 8 bits of blue, green and red, the order in which FFV1 takes them.
            None => _ = command.args(["-pix_fmt", "bgr0"]),
        }
        command.args(container.arguments(codec));
        command.arg(file_argument(output.path())).stdin(Stdio::piped());
        let mut running = spawn(&program, &mut command)?;
        let stdin = running.child.stdin.take();
        Ok(Self { program, size_px, extends, stdin, running: Some(running), output })
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
        let written = match (&mut self.stdin, self.extends) {
            (Some(stdin), false) => stdin.write_all(frame.rgb()),
            (Some(stdin), true) => stdin.write_all(&extended(frame)),
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
/// [`EngineError::Usage`] for no frames or frames of different sizes; those of [`VideoWriter`].
pub fn write_video(path: &Path, frames: &[Frame], options: &EncodeOptions) -> Result<(), EngineError> {
    let first = frames.first().ok_or_else(|| EngineError::Usage {
        what: "frames to encode".to_owned(),
        got: "none".to_owned(),
        expected: "at least one".to_owned(),
    })?;
    let mut writer = VideoWriter::start(path, (first.width(), first.height()), options)?;
    for frame in frames {
        writer.push(frame)?;
    }
    writer.finish()
}

/// Full-range RGB to limited-range BT.709 with exact rounding.
const TO_BT709: &str = "scale=out_color_matrix=bt709:in_range=pc:out_range=tv:\
                        flags=bicubic+accurate_rnd+full_chroma_int+full_chroma_inp,format=yuv420p";

/// Container, codec and rate factor; a lossless codec has none.
fn format(path: &Path, options: &EncodeOptions) -> Result<(Container, Codec, Option<u8>), EngineError> {
    let usage = |what: &str, got: String, expected: String| EngineError::Usage { what: what.to_owned(), got, expected };
    let container = Container::of(path).ok_or_else(|| {
        usage("video file", path.display().to_string(), "a name that ends with .mp4, .mov, .mkv or .webm".to_owned())
    })?;
    let codec = options.codec.unwrap_or(container.default_codec());
    if !container.codecs().contains(&codec) {
        let names: Vec<_> = container.codecs().iter().map(|codec| codec.name()).collect();
        let extension = path.extension().unwrap_or_default().display().to_string();
        let expected = format!("{} in .{extension}; .mkv holds all", names.join(", "));
        return Err(usage("codec", codec.name().to_owned(), expected));
    }
    match (options.crf, codec.max_crf()) {
        (Some(crf), None) => Err(usage("crf", crf.to_string(), format!("none, because {codec} loses nothing"))),
        (Some(crf), Some(max)) if crf > max => Err(usage("crf", crf.to_string(), format!("0 to {max} for {codec}"))),
        (crf, _) => Ok((container, codec, crf.or(codec.default_crf()))),
    }
}

fn check_size(size_px: (u32, u32), codec: Codec, odd_size: OddSize) -> Result<(), EngineError> {
    let (width, height) = size_px;
    let is_odd = width % 2 == 1 || height % 2 == 1;
    if width == 0 || height == 0 || (is_odd && odd_size == OddSize::Refuse && !codec.is_lossless()) {
        return Err(EngineError::Usage {
            what: "size of a video".to_owned(),
            got: format!("{width} x {height} px"),
            expected: "even width and height; write a PNG folder or FFV1 for odd sizes".to_owned(),
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
