//! `guard4d attack`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::error::EngineError;
use guard4d_engine::media::FrameSource;
use guard4d_engine::picture::distortion::{Distortion, DistortionChain};

use crate::flags::common::Common;
use crate::flags::film::FilmArgs;
use crate::flags::frames::FrameArgs;
use crate::shared::farm_job::{FarmJob, keep_in_records, out_and_input};
use crate::shared::media::read_some;
use crate::shared::{device, film};
use crate::ui::outcome::Outcome;
use crate::ui::progress::bar;
use crate::ui::stop;

/// Which film is distorted, and how.
#[derive(Args, Debug)]
pub(crate) struct AttackArgs {
    /// Folder of PNG, JPEG or OpenEXR frames, or video file
    clip: PathBuf,
    /// What to do to every frame, one after the other: NAME:STRENGTH
    ///
    /// noise (standard deviation, colours being in [0, 1]), rotation (degrees, black outside), rescale (share of each
    /// side, and back), blur (standard deviation in px), crop (share of each side that is kept and enlarged),
    /// brightness (factor), jpeg (quality), codec (low pass in px with chroma at half resolution; --out FILE.mp4 --crf
    /// is a real codec), mirror, identity. Each rounds to 8 bits.
    #[arg(long = "apply", value_name = "NAME:STRENGTH", value_delimiter = ',', required = true)]
    distortions: Vec<Distortion>,
    /// Seed of noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    frames: FrameArgs,
    #[command(flatten)]
    film: FilmArgs,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "attack",
    has_input: true,
    needs_device: true,
    arguments: out_and_input,
    reserved: &["out", "overwrite"],
    keep: keep_in_records,
    trial: None,
};

pub(crate) fn run(args: &AttackArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let source = FrameSource::open(&args.clip, &read_some(&args.frames))?;
    let size = source.size_px()?;
    let device = device::open(common)?;
    let mut attack = DistortionChain::new(&device, size, &args.distortions, args.seed)?;
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
