//! `guard4d attack`

use guard4d_engine::EngineError;
use guard4d_engine::distortion::Attack;
use guard4d_engine::media::clip::read_clip;

use crate::args::{AttackArgs, Common};
use crate::devices;
use crate::film;
use crate::media::read_options;
use crate::progress::bar;
use crate::report::Outcome;
use crate::stop;

pub(crate) fn run(args: &AttackArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let clip = read_clip(&args.clip, &read_options())?;
    let device = devices::open(common)?;
    let size = clip.size_px();
    let mut attack = Attack::new(&device, size, &args.distortions, args.seed)?;
    let progress = bar(common, clip.frames().len() as u64);
    film::write(&args.film, size, |each| {
        for (number, frame) in (0..).zip(clip.frames()) {
            stop::check()?;
            progress.inc(1);
            each(attack.apply(frame, number)?)?;
        }
        Ok(())
    })?;
    progress.finish_and_clear();
    Ok(Outcome::Done)
}
