//! `guard4d pretrain-extractor`

use std::fmt::Write as _;

use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::output::{AtomicFile, Existing};
use guard4d_engine::watermark::embed::pretrain::{PretrainConfig, Pretraining, SceneReport};

use crate::args::{Common, PretrainArgs};
use crate::embed::{checkpoint_path, remove_checkpoint};
use crate::progress::bar;
use crate::report::{Outcome, note};
use crate::{devices, stop};

pub(crate) fn run(args: &PretrainArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    // An hour of training must not end at a place that cannot be written.
    drop(AtomicFile::create(&args.out, existing)?);
    let device = devices::open(common)?;
    let clip = Clip::load(&device, &ClipSource::from_argument(&args.clip))?;
    let config = config(args);
    let progress = bar(common, config.num_scenes() as u64);
    let mut training = Pretraining::prepare(&device, &clip, config)?;
    let checkpoint = checkpoint_path(&args.out);
    if args.resume {
        training.restore(&checkpoint)?;
    }
    while let Some(report) = training.step()? {
        progress.set_position(report.number as u64);
        progress.set_message(format!("separation {:.1} %", 100.0 * report.separation));
        training.save(&checkpoint)?;
        if stop::is_requested() {
            progress.abandon();
            return Err(EngineError::Interrupted { checkpoint });
        }
    }
    progress.finish_and_clear();
    let general = training.extractor(command(args))?;
    AtomicFile::write(&args.out.with_extension("csv"), Existing::Replace, curve(training.reports()).as_bytes())?;
    general.write(&args.out, existing)?;
    remove_checkpoint(&checkpoint);
    note(common, &format!("wrote {}, {}", args.out.display(), general.digest()?));
    Ok(Outcome::Done)
}

/// The learning curve.
fn curve(reports: &[SceneReport]) -> String {
    let mut text = String::from("scenes,scene,seconds,separation\n");
    for SceneReport { number, scene, seconds, separation } in reports {
        let _ = writeln!(text, "{number},{scene},{seconds:.1},{separation:.4}");
    }
    text
}

/// The command that gives this extractor again.
fn command(args: &PretrainArgs) -> String {
    let PretrainArgs { scenes, bits, seed, train_clips, responses, size, .. } = args;
    let scenes = scenes.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
    format!(
        "guard4d pretrain-extractor --scenes {scenes} --bits {bits} --seed {seed} --train-clips {train_clips} --responses {responses} \
         --size {size}"
    )
}

fn config(args: &PretrainArgs) -> PretrainConfig {
    PretrainConfig {
        bits: args.bits as usize,
        seed: args.seed,
        scenes: args.scenes.clone(),
        probes: args.probes.clone(),
        clips: args.train_clips,
        responses: args.responses as usize,
        size_px: args.size,
    }
}
