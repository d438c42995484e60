//! Any video ffmpeg knows, to full-range RGB frames.

use std::io::{BufRead, BufReader, Read as _};
use std::num::NonZeroU32;
use std::path::Path;
use std::process::{ChildStdout, Command, Stdio};

use serde::Deserialize;

use super::ffmpeg::{Ffmpeg, file_argument, spawn};
use super::frames::{Frame, FrameRate, Integrity, MAX_SIDE_PX};
use super::options::ReadOptions;
use crate::base::files::bad_data;
use crate::error::EngineError;

/// Fewest lines at which untagged video is taken for BT.709 rather than BT.601.
const HD_LINES: u32 = 720;

/// Longest header line ffmpeg's PAM encoder writes is far below this.
const MAX_HEADER_LINE: u64 = 128;

/// What ffprobe is asked for.
const ENTRIES: &str = "stream=codec_name,width,height,pix_fmt,color_range,color_space,avg_frame_rate,nb_frames:\
                       stream_tags=alpha_mode,ALPHA_MODE:format=duration";

/// More frames than any video has; an estimate beyond is a broken header.
const MAX_ESTIMATE: f64 = 1e9;

/// How swscale is asked to compute: exactly rounded, and without noise.
const EXACTLY: &str = "sws_dither=none:flags=bicubic+accurate_rnd+full_chroma_int+full_chroma_inp";

#[derive(Deserialize)]
struct Probe {
    #[serde(default)]
    streams: Vec<Stream>,
    format: Option<Container>,
}

#[derive(Debug, Default, Deserialize)]
struct Container {
    duration: Option<String>,
}

/// What ffprobe says of a video stream; everything may be missing.
#[derive(Debug, Deserialize)]
pub(super) struct Stream {
    pub(super) codec_name: Option<String>,
    pub(super) width: Option<u32>,
    pub(super) height: Option<u32>,
    pub(super) pix_fmt: Option<String>,
    color_range: Option<String>,
    color_space: Option<String>,
    avg_frame_rate: Option<String>,
    nb_frames: Option<String>,
    #[serde(default)]
    tags: Tags,
    #[serde(skip)]
    container: Container,
}

#[derive(Debug, Default, Deserialize)]
struct Tags {
    #[serde(alias = "ALPHA_MODE")]
    alpha_mode: Option<String>,
}

impl Stream {
    /// Number of frames, as counted by the container or estimated from its duration.
    pub(super) fn num_frames(&self) -> Option<u64> {
        let counted = self.nb_frames.as_deref().and_then(|count| count.parse().ok()).filter(|count| *count > 0);
        counted.or_else(|| {
            let seconds: f64 = self.container.duration.as_deref()?.parse().ok()?;
            let rate = parse_rate(self.avg_frame_rate.as_deref()?)?;
            let frames = seconds * f64::from(rate.frames.get()) / f64::from(rate.seconds.get());
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "it is between the two bounds, and an estimate"
            )]
            (1.0..MAX_ESTIMATE).contains(&frames).then_some(frames.round() as u64)
        })
    }

    /// The decoder to name, where the one that ffmpeg takes by itself drops the alpha channel: WebM stores it as a
    /// second picture, which libvpx alone decodes.
    fn decoder(&self) -> Option<&'static str> {
        self.tags.alpha_mode.as_deref().filter(|mode| *mode == "1")?;
        match self.codec_name.as_deref()? {
            "vp8" => Some("libvpx"),
            "vp9" => Some("libvpx-vp9"),
            _ => None,
        }
    }
}

/// Decodes a video's first video stream and hands over the frames that `options` ask for, each as stored: none is
/// dropped or repeated for a constant rate. Range and matrix tags are honoured; untagged video is limited-range BT.601,
/// or BT.709 from 720 lines. Rotation is applied, transparency laid over the background. Deeper video is rounded to 8
/// bits without dithering.
///
/// # Errors
/// [`EngineError::BadData`] if nothing can be decoded, [`EngineError::Program`] without ffmpeg, and
/// whatever `each` returns, which stops decoding.
pub(super) fn for_each_frame(
    path: &Path,
    stream: &Stream,
    options: &ReadOptions,
    each: &mut dyn FnMut(Frame) -> Result<(), EngineError>,
) -> Result<(Option<FrameRate>, Integrity), EngineError> {
    let has_alpha = stream.decoder().is_some() || has_alpha(stream.pix_fmt.as_deref().unwrap_or_default());
    let mut command = Command::new(&options.ffmpeg.ffmpeg);
    command.args(["-hide_banner", "-loglevel", "error", "-nostdin"]);
    if let Some(decoder) = stream.decoder() {
        command.args(["-c:v", decoder]);
    }
    command.args(["-protocol_whitelist", "file,pipe", "-i"]);
    command.arg(file_argument(path)).args(["-map", "0:v:0"]);
    if let Some(limit) = options.max_frames {
        command.args(["-frames:v", &limit.to_string()]);
    }
    let filters: Vec<_> = selection(options).into_iter().chain([conversion(stream)]).collect();
    command.args(["-vf", &filters.join(",")]);
    command.args(["-fps_mode", "passthrough", "-f", "image2pipe"]);
    let samples = if has_alpha { "rgba" } else { "rgb24" };
    command.args(["-c:v", "pam", "-pix_fmt", samples, "pipe:1"]);
    let mut running = spawn(&options.ffmpeg.ffmpeg, command.stdin(Stdio::null()))?;
    let stdout = running.child.stdout.take().expect("spawn pipes stdout");
    let mut stdout = BufReader::new(stdout);
    let mut num_frames = 0_u32;
    let damage = loop {
        match read_pam(&mut stdout, options.background) {
            Ok(Some(frame)) => each(frame)?,
            Ok(None) => break None,
            Err(error) => break Some(error.to_string()),
        }
        num_frames += 1;
    };
    drop(stdout);
    let ended = running.wait()?;
    let messages = damage.unwrap_or(ended.messages);
    if num_frames == 0 && !(ended.success && messages.is_empty()) {
        return Err(undecodable(path, "frames", &messages));
    }
    let integrity = if ended.success && messages.is_empty() {
        Integrity::Intact
    } else {
        tracing::warn!(path = %path.display(), num_frames, messages, "the video is damaged");
        Integrity::Damaged { messages }
    };
    let rate = stream.avg_frame_rate.as_deref().and_then(parse_rate);
    Ok((rate, integrity))
}

/// What ffprobe says of the first video stream.
///
/// # Errors
/// [`EngineError::BadData`] for a file without one, [`EngineError::Program`] without ffprobe.
pub(super) fn probe(path: &Path, ffmpeg: &Ffmpeg) -> Result<Stream, EngineError> {
    let program = &ffmpeg.ffprobe;
    let mut command = Command::new(program);
    command.args(["-v", "error", "-protocol_whitelist", "file,pipe"]);
    command.args(["-select_streams", "v:0", "-of", "json", "-show_entries"]);
    command.arg(ENTRIES);
    command.arg(file_argument(path)).stdin(Stdio::null());
    let mut running = spawn(program, &mut command)?;
    let mut json = Vec::new();
    if let Some(mut stdout) = running.child.stdout.take() {
        stdout.read_to_end(&mut json).map_err(|source| EngineError::Io { path: path.to_path_buf(), source })?;
    }
    let ended = running.wait()?;
    if !ended.success {
        return Err(undecodable(path, "container", &ended.messages));
    }
    let probe: Probe =
        serde_json::from_slice(&json).map_err(|error| undecodable(path, "container", &error.to_string()))?;
    let stream = probe.streams.into_iter().next();
    let stream = stream.ok_or_else(|| undecodable(path, "streams", "no video stream"))?;
    Ok(Stream { container: probe.format.unwrap_or_default(), ..stream })
}

pub(super) fn undecodable(path: &Path, field: &str, messages: &str) -> EngineError {
    let got = if messages.is_empty() { "nothing decodable" } else { messages };
    bad_data(path, field, got, "a video that ffmpeg can decode")
}

/// Names of planar and packed formats with an alpha plane.
fn has_alpha(pixel_format: &str) -> bool {
    let packed = ["rgba", "bgra", "argb", "abgr", "gbrap", "ya8", "ya16", "pal8"];
    pixel_format.starts_with("yuva") || packed.iter().any(|name| pixel_format.starts_with(name))
}

/// Filter that passes the frames that are asked for; none passes all.
fn selection(options: &ReadOptions) -> Option<String> {
    let (start, every) = (options.start, options.every);
    (start > 0 || every.get() > 1).then(|| format!("select='gte(n,{start})*not(mod(n-{start},{every}))'"))
}

/// Scale filter to full-range RGB; it fixes matrix and range of a luma-chroma stream.
fn conversion(stream: &Stream) -> String {
    let format = stream.pix_fmt.as_deref().unwrap_or_default();
    let is_luma =
        ["yuv", "nv", "p0", "gray", "ya", "uyvy", "vuy", "y2"].iter().any(|prefix| format.starts_with(prefix));
    if !is_luma {
        return format!("scale={EXACTLY}");
    }
    let matrix = match stream.color_space.as_deref() {
        Some(tag @ ("bt709" | "fcc" | "smpte170m" | "smpte240m")) => tag,
        Some("bt470bg") => "bt470",
        Some("bt2020nc" | "bt2020c") => "bt2020",
        _ if stream.height.is_some_and(|lines| lines >= HD_LINES) => "bt709",
        _ => "smpte170m",
    };
    let range = match stream.color_range.as_deref() {
        Some("pc") => "pc",
        None if format.starts_with("yuvj") => "pc",
        _ => "tv",
    };
    format!("scale=in_color_matrix={matrix}:in_range={range}:out_range=pc:{EXACTLY}")
}

fn parse_rate(text: &str) -> Option<FrameRate> {
    let (frames, seconds) = text.split_once('/')?;
    let number = |digits: &str| digits.parse().ok().and_then(NonZeroU32::new);
    Some(FrameRate { frames: number(frames)?, seconds: number(seconds)? })
}

/// Reads one picture in Netpbm's PAM form (`P7`, header lines, `ENDHDR`, samples); none at the end.
fn read_pam(stdout: &mut BufReader<ChildStdout>, background: [u8; 3]) -> Result<Option<Frame>, EngineError> {
    let (mut width, mut height, mut depth) = (0, 0, 0);
    let mut line = String::new();
    loop {
        line.clear();
        let count = stdout.by_ref().take(MAX_HEADER_LINE).read_line(&mut line);
        if count.map_err(|error| broken(&error.to_string()))? == 0 {
            return if depth == 0 { Ok(None) } else { Err(broken("a cut header")) };
        }
        let mut words = line.split_whitespace();
        let (name, value) = (words.next(), words.next().and_then(|word| word.parse().ok()));
        match (name, value) {
            (Some("WIDTH"), Some(value)) => width = value,
            (Some("HEIGHT"), Some(value)) => height = value,
            (Some("DEPTH"), Some(value)) => depth = value,
            (Some("ENDHDR"), None) => break,
            (Some("P7" | "MAXVAL" | "TUPLTYPE"), _) => {}
            _ => return Err(broken("an unknown header line")),
        }
    }
    let is_sound = (1..=MAX_SIDE_PX).contains(&width) && (1..=MAX_SIDE_PX).contains(&height);
    if !is_sound || !matches!(depth, 3 | 4) {
        return Err(broken(&format!("{width} x {height} px, {depth} channels")));
    }
    let mut samples = vec![0; width as usize * height as usize * depth as usize];
    stdout.read_exact(&mut samples).map_err(|_| broken("a cut frame"))?;
    if depth == 4 {
        return Frame::from_rgba8(width, height, &samples, background).map(Some);
    }
    Frame::new(width, height, samples).map(Some)
}

fn broken(got: &str) -> EngineError {
    EngineError::Program { program: "ffmpeg".to_owned(), reason: format!("its output holds {got}") }
}
