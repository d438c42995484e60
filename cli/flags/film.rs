//! How a film is written.

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::media::codec::Codec;

use super::overwrite::Overwrite;

/// Where frames go.
#[derive(Args, Debug)]
#[command(next_help_heading = "Film")]
pub(crate) struct FilmArgs {
    /// Folder for PNG frames, or a .mp4, .mov, .mkv or .webm file
    #[arg(long, value_name = "PATH")]
    pub(crate) out: PathBuf,
    /// Frames per second of a video
    #[arg(long, default_value_t = 24)]
    pub(crate) fps: u32,
    /// Codec of a video: h264, h265, av1, vp9, or ffv1, which is lossless
    ///
    /// Unless given, vp9 for .webm and h264 for the others. .mp4 holds all but ffv1, .mov h264 and h265, .webm vp9 and
    /// av1, .mkv all.
    #[arg(long)]
    pub(crate) codec: Option<Codec>,
    /// Quality of a video; 0 is best
    ///
    /// h264 (unless given, 12) and h265 (14) go to 51, av1 (16) and vp9 (16) to 63.
    #[arg(long, value_name = "QUALITY")]
    pub(crate) crf: Option<u8>,
    #[command(flatten)]
    pub(crate) overwrite: Overwrite,
}
