//! Frames as a folder of pictures or a video, whole or not at all.

use std::num::NonZeroU32;

use guard4d_engine::base::output::AtomicDir;
use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::media::codec::Container;
use guard4d_engine::media::encode::{EncodeOptions, VideoWriter};
use guard4d_engine::media::frames::FrameRate;
use guard4d_engine::media::png::{png_name, write_png};

use super::media::ffmpeg;
use crate::flags::film::FilmArgs;
use crate::ui::stop;

/// Writes the frames, all of `size` (width, height) in pixels, that `shoot` hands to its argument.
pub(crate) fn write(
    args: &FilmArgs,
    size: (u32, u32),
    shoot: impl FnOnce(&mut dyn FnMut(Frame) -> Result<(), EngineError>) -> Result<(), EngineError>,
) -> Result<(), EngineError> {
    let existing = args.overwrite.existing();
    if Container::of(&args.out).is_some() {
        let fps = NonZeroU32::new(args.fps).ok_or_else(|| EngineError::Usage {
            what: "--fps".to_owned(),
            got: "0".to_owned(),
            expected: "at least 1".to_owned(),
        })?;
        let options = EncodeOptions {
            ffmpeg: ffmpeg(),
            frame_rate: FrameRate::per_second(fps),
            codec: args.codec,
            crf: args.crf,
            existing,
            ..EncodeOptions::default()
        };
        // An interruption may end ffmpeg first, which is no failure of its own.
        let started = VideoWriter::start(&args.out, size, &options);
        let mut writer = started.or_else(|error| stop::check().and(Err(error)))?;
        shoot(&mut |frame| writer.push(&frame))?;
        return writer.finish();
    }
    // A folder has no codec; whoever names one meant a video, and the extension is wrong.
    if let Some(codec) = args.codec {
        return Err(EngineError::Usage {
            what: "--codec".to_owned(),
            got: format!("{codec} for a folder"),
            expected: "--out with .mp4, .mov, .mkv or .webm".to_owned(),
        });
    }
    let folder = AtomicDir::create(&args.out, existing)?;
    let mut number = 0;
    shoot(&mut |frame| {
        let path = folder.path().join(png_name(number));
        number += 1;
        write_png(&path, &frame)
    })?;
    folder.commit()
}
