//! Programs and files for video.

use guard4d_engine::media::ReadOptions;
use guard4d_engine::media::ffmpeg::Ffmpeg;

use crate::flags::frames::FrameArgs;

/// ffmpeg and ffprobe, as the environment names them or from the search path.
pub(crate) fn ffmpeg() -> Ffmpeg {
    let default = Ffmpeg::default();
    Ffmpeg {
        ffmpeg: std::env::var_os("GUARD4D_FFMPEG").map_or(default.ffmpeg, Into::into),
        ffprobe: std::env::var_os("GUARD4D_FFPROBE").map_or(default.ffprobe, Into::into),
    }
}

/// How whole clips are read.
pub(crate) fn read_options() -> ReadOptions {
    ReadOptions { ffmpeg: ffmpeg(), ..ReadOptions::default() }
}

/// How the frames that are asked for are read.
pub(crate) fn read_some(frames: &FrameArgs) -> ReadOptions {
    let FrameArgs { start, every, max_frames } = *frames;
    ReadOptions { start, every, max_frames, ..read_options() }
}
