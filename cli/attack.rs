//! `guard4d attack`

use guard4d_engine::EngineError;
use guard4d_engine::distortion::Attack;
use guard4d_engine::media::FrameSource;

use crate::args::{AttackArgs, Common};
use crate::devices;
use crate::film;
use crate::media::read_some;
use crate::progress::bar;
use crate::report::Outcome;
use crate::stop;

pub(crate) fn run(args: &AttackArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let source = FrameSource::open(&args.clip, &read_some(&args.frames))?;
    let size = source.size_px()?;
    let device = devices::open(common)?;
    let mut attack = Attack::new(&device, size, &args.distortions, args.seed)?;
    let progress = bar(common, source.expected_frames().unwrap_or(0));
    film::write(&args.film, size, |each| {
        let mut number = 0;
        source.for_each(&mut |frame| {
            stop::check()?;
            progress.inc(1);
            each(attack.apply(&frame, number)?)?;
            number += 1;
            Ok(())
        })?;
        Ok(())
    })?;
    progress.finish_and_clear();
    Ok(Outcome::Done)
}
