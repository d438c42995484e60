//! OpenEXR pictures, through ffmpeg.

use std::io::Read as _;
use std::path::Path;
use std::process::{Command, Stdio};

use super::decode::{Stream, probe, undecodable};
use super::ffmpeg::{Ffmpeg, file_argument, spawn};
use super::frames::{Frame, MAX_SIDE_PX};
use crate::error::EngineError;

/// ffmpeg's name of planes G, B, R and alpha in 32-bit floats.
const WITH_ALPHA: &str = "gbrapf32le";
/// The same without alpha.
const OPAQUE: &str = "gbrpf32le";

/// Reads an OpenEXR picture with 8-bit sRGB code values, as a viewer shows it without exposure: light above 1 is 1,
/// colours go through the sRGB transfer function (IEC 61966-2-1) and are rounded. Colours count as those of BT.709,
/// whatever primaries the file names. Alpha is associated with the colours, as the format has it: the picture is laid
/// over `background` in linear light.
///
/// # Errors
/// [`EngineError::MissingInput`], [`EngineError::BadData`] if it is no OpenEXR picture, [`EngineError::NotFinite`] for
/// a sample that is NaN, [`EngineError::Program`] without ffmpeg.
pub(super) fn read(path: &Path, background: [u8; 3], ffmpeg: &Ffmpeg) -> Result<Frame, EngineError> {
    if !path.is_file() {
        return Err(EngineError::MissingInput { path: path.to_path_buf(), expected: "an OpenEXR file".to_owned() });
    }
    let stream = probe(path, ffmpeg)?;
    if stream.codec_name.as_deref() != Some("exr") {
        return Err(undecodable(path, "picture", "another format"));
    }
    let (width, height) = size(path, &stream)?;
    let format = if stream.pix_fmt.as_deref() == Some(WITH_ALPHA) { WITH_ALPHA } else { OPAQUE };
    let planes = decode(path, ffmpeg, format)?;
    let pixels = width as usize * height as usize;
    let channels = if format == WITH_ALPHA { 4 } else { 3 };
    if planes.len() != pixels * channels {
        return Err(undecodable(path, "picture", &format!("{} samples for {pixels} pixels", planes.len())));
    }
    let behind = background.map(|level| to_light(f32::from(level) / 255.0));
    let mut rgba = Vec::with_capacity(4 * pixels);
    for at in 0..pixels {
        let [green, blue, red] = [0, 1, 2].map(|plane| planes[plane * pixels + at]);
        let alpha = if channels == 4 { planes[3 * pixels + at] } else { 1.0 };
        let over = |light: f32, behind: f32| to_code(light + (1.0 - alpha) * behind);
        rgba.extend([over(red, behind[0]), over(green, behind[1]), over(blue, behind[2]), 0.0]);
    }
    Frame::from_rgba32f(width, height, &rgba)
}

fn size(path: &Path, stream: &Stream) -> Result<(u32, u32), EngineError> {
    let side = |length: Option<u32>| length.filter(|side| (1..=MAX_SIDE_PX).contains(side));
    let size = side(stream.width).zip(side(stream.height));
    size.ok_or_else(|| undecodable(path, "size", &format!("sides of 0 or more than {MAX_SIDE_PX} px")))
}

/// All samples, plane after plane.
fn decode(path: &Path, ffmpeg: &Ffmpeg, format: &str) -> Result<Vec<f32>, EngineError> {
    let mut command = Command::new(&ffmpeg.ffmpeg);
    command.args(["-hide_banner", "-loglevel", "error", "-nostdin", "-protocol_whitelist", "file,pipe", "-i"]);
    command.arg(file_argument(path)).args(["-map", "0:v:0", "-frames:v", "1"]);
    command.args(["-f", "rawvideo", "-pix_fmt", format, "pipe:1"]);
    let mut running = spawn(&ffmpeg.ffmpeg, command.stdin(Stdio::null()))?;
    let mut bytes = Vec::new();
    let stdout = running.child.stdout.take().expect("spawn pipes stdout");
    // One picture of at most that many samples; the caller compares the length.
    let most = u64::from(MAX_SIDE_PX) * u64::from(MAX_SIDE_PX) * 4 * 4;
    let read = stdout.take(most).read_to_end(&mut bytes);
    read.map_err(|source| EngineError::Io { path: path.to_path_buf(), source })?;
    let ended = running.wait()?;
    if !ended.success || !ended.messages.is_empty() {
        return Err(undecodable(path, "picture", &ended.messages));
    }
    Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

/// sRGB's transfer function, light in \[0, 1\] to code values in \[0, 1\]. Infinite light is white; NaN stays NaN.
fn to_code(light: f32) -> f32 {
    let light = light.clamp(0.0, 1.0);
    if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

/// Its inverse.
fn to_light(code: f32) -> f32 {
    if code <= 0.040_45 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) }
}
