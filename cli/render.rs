//! `guard4d render`

use std::num::NonZeroU32;

use guard4d_engine::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::media::clip::FrameRate;
use guard4d_engine::media::encode::{EncodeOptions, Mp4Writer};
use guard4d_engine::media::frames::{png_name, write_png};
use guard4d_engine::output::{AtomicDir, Existing};
use guard4d_engine::render::Film;
use guard4d_engine::scene::Model;

use crate::args::{Common, RenderArgs};
use crate::devices;
use crate::media::ffmpeg;
use crate::progress::bar;
use crate::report::Outcome;
use crate::stop;
use crate::views::cameras;

pub(crate) fn run(args: &RenderArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let device = devices::open(common)?;
    let model = Model::open(&args.model)?;
    let clips = cameras(&args.views)?.clips();
    let total: usize = clips.iter().map(Vec::len).sum();
    let progress = bar(common, total as u64);
    let mut film = Film::new(&device, &model.gaussians, model.deformation.as_ref(), model.background)?;
    let mut shoot = |each: &mut dyn FnMut(Frame) -> Result<(), EngineError>| {
        film.shoot(&clips, |_, camera, pixels| {
            stop::check()?;
            progress.inc(1);
            each(Frame::from_rgba32f(camera.width, camera.height, pixels)?)
        })
    };
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    if args.out.extension().is_some_and(|e| e == "mp4") {
        let fps = NonZeroU32::new(args.fps).ok_or_else(|| EngineError::Usage {
            what: "--fps".to_owned(),
            got: "0".to_owned(),
            expected: "at least 1".to_owned(),
        })?;
        let options = EncodeOptions {
            ffmpeg: ffmpeg(),
            frame_rate: FrameRate::per_second(fps),
            crf: args.crf,
            existing,
            ..EncodeOptions::default()
        };
        let mut writer = Mp4Writer::start(&args.out, args.views.size, &options)?;
        shoot(&mut |frame| writer.push(&frame))?;
        writer.finish()?;
    } else {
        let folder = AtomicDir::create(&args.out, existing)?;
        let mut number = 0;
        shoot(&mut |frame| {
            let path = folder.path().join(png_name(number));
            number += 1;
            write_png(&path, &frame)
        })?;
        folder.commit()?;
    }
    progress.finish_and_clear();
    Ok(Outcome::Done)
}
