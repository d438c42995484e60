//! Codecs and containers that videos are written in.

use std::fmt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::str::FromStr;

use super::ffmpeg::{Ffmpeg, failed, spawn};
use crate::error::EngineError;

/// How a video is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// H.264, by x264.
    H264,
    /// H.265, by x265.
    H265,
    /// AV1, by libaom or, where that is missing, by SVT-AV1.
    Av1,
    /// VP9, by libvpx.
    Vp9,
    /// FFV1 in RGB: lossless, every frame by itself, with checksums.
    Ffv1,
}

/// What holds the compressed video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// `.mp4`
    Mp4,
    /// `.mov`
    Mov,
    /// `.mkv`
    Matroska,
    /// `.webm`
    WebM,
}

impl Codec {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::H264, Self::H265, Self::Av1, Self::Vp9, Self::Ffv1];

    /// The name that the command line uses.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::H264 => "h264",
            Self::H265 => "h265",
            Self::Av1 => "av1",
            Self::Vp9 => "vp9",
            Self::Ffv1 => "ffv1",
        }
    }

    /// Whether decoded frames equal the frames that were encoded.
    #[must_use]
    pub const fn is_lossless(self) -> bool {
        matches!(self, Self::Ffv1)
    }

    /// The constant rate factor taken by default: of H.264 the one that studies of this program use, of the others
    /// about the same fidelity.
    #[must_use]
    pub const fn default_crf(self) -> Option<u8> {
        match self {
            Self::H264 => Some(12),
            Self::H265 => Some(14),
            Self::Av1 | Self::Vp9 => Some(16),
            Self::Ffv1 => None,
        }
    }

    /// The largest constant rate factor that the encoder takes for 8-bit video; none if there is nothing to lose.
    #[must_use]
    pub const fn max_crf(self) -> Option<u8> {
        match self {
            Self::H264 | Self::H265 => Some(51),
            Self::Av1 | Self::Vp9 => Some(63),
            Self::Ffv1 => None,
        }
    }

    /// ffmpeg's encoders for it, the best first.
    const fn encoders(self) -> &'static [&'static str] {
        match self {
            Self::H264 => &["libx264"],
            Self::H265 => &["libx265"],
            Self::Av1 => &["libaom-av1", "libsvtav1"],
            Self::Vp9 => &["libvpx-vp9"],
            Self::Ffv1 => &["ffv1"],
        }
    }

    /// What an encoder is told, besides the rate factor. Encoders that would write about their work are kept silent,
    /// because whatever they say counts as an error.
    pub(super) fn arguments(encoder: &str) -> &'static [&'static str] {
        match encoder {
            "libx265" => &["-x265-params", "log-level=error"],
            // Without a speed, libaom takes minutes for a second of video; with rate 0 the factor alone decides.
            "libaom-av1" => &["-b:v", "0", "-cpu-used", "6", "-row-mt", "1"],
            "libvpx-vp9" => &["-b:v", "0", "-cpu-used", "2", "-row-mt", "1"],
            "ffv1" => &["-level", "3", "-g", "1", "-slicecrc", "1"],
            _ => &[],
        }
    }

    /// The first encoder of the codec that this ffmpeg has.
    ///
    /// # Errors
    /// [`EngineError::Program`] if it has none, or is not there.
    pub(super) fn encoder(self, ffmpeg: &Ffmpeg) -> Result<&'static str, EngineError> {
        let program = &ffmpeg.ffmpeg;
        let mut command = Command::new(program);
        command.args(["-hide_banner", "-loglevel", "error", "-encoders"]).stdin(Stdio::null());
        let mut running = spawn(program, &mut command)?;
        let stdout = running.child.stdout.take().expect("spawn pipes stdout");
        let list = std::io::read_to_string(stdout).map_err(|error| failed(program, &error.to_string()))?;
        let ended = running.wait()?;
        if !ended.success {
            return Err(failed(program, &format!("it ended before it had listed its encoders: {}", ended.messages)));
        }
        // Each line begins with the encoder's abilities and its name.
        let has = |encoder: &&str| list.lines().any(|line| line.split_whitespace().nth(1) == Some(*encoder));
        self.encoders().iter().find(|encoder| has(encoder)).copied().ok_or_else(|| {
            let wanted = self.encoders().join(" or ");
            failed(program, &format!("it has no encoder for {self} ({wanted}); take another codec or another ffmpeg"))
        })
    }
}

impl fmt::Display for Codec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Codec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|codec| codec.name() == text);
        found.ok_or_else(|| format!("one of {} is expected", Self::ALL.map(Self::name).join(", ")))
    }
}

impl Container {
    /// By the extension; none if it is no video's.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "mp4" => Some(Self::Mp4),
            "mov" => Some(Self::Mov),
            "mkv" => Some(Self::Matroska),
            "webm" => Some(Self::WebM),
            _ => None,
        }
    }

    /// The codec taken by default.
    #[must_use]
    pub const fn default_codec(self) -> Codec {
        match self {
            Self::Mp4 | Self::Mov | Self::Matroska => Codec::H264,
            Self::WebM => Codec::Vp9,
        }
    }

    /// Codecs that players expect in it.
    #[must_use]
    pub const fn codecs(self) -> &'static [Codec] {
        match self {
            Self::Mp4 => &[Codec::H264, Codec::H265, Codec::Av1, Codec::Vp9],
            Self::Mov => &[Codec::H264, Codec::H265],
            Self::Matroska => &Codec::ALL,
            Self::WebM => &[Codec::Vp9, Codec::Av1],
        }
    }

    /// ffmpeg's arguments for it.
    pub(super) fn arguments(self, codec: Codec) -> Vec<&'static str> {
        let mut arguments = match self {
            Self::Mp4 => vec!["-movflags", "+faststart", "-f", "mp4"],
            Self::Mov => vec!["-movflags", "+faststart", "-f", "mov"],
            Self::Matroska => vec!["-f", "matroska"],
            Self::WebM => vec!["-f", "webm"],
        };
        if codec == Codec::H265 && matches!(self, Self::Mp4 | Self::Mov) {
            // The name under which Apple's players know it.
            arguments.splice(0..0, ["-tag:v", "hvc1"]);
        }
        arguments
    }
}
