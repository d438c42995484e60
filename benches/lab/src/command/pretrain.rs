//! `guard4d lab pretrain`

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::checkpoint;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::message::MAX_MESSAGE_BITS;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::watermark::embed::pretrain::{PretrainConfig, Pretraining, SceneReport, Scenery};

use super::host::Host;

#[derive(Args, Debug)]
pub(super) struct PretrainArgs {
    /// CLIP checkpoint: `mini` (embedded) or a folder with config.json and model.safetensors
    #[arg(long, default_value = "mini")]
    clip: String,
    /// Scenes to learn from: `procedural:N` for N of random shapes and textures, and models
    #[arg(long, value_delimiter = ',', default_value = "procedural:96")]
    scenes: Vec<Scenery>,
    /// Scenes that the learning curve is about, and that are not learned from
    #[arg(long, value_delimiter = ',', default_value = "procedural:3")]
    probes: Vec<Scenery>,
    /// Most bits of a message that it can read; `mini` has keys of at most 72
    #[arg(long, default_value_t = 72, value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_MESSAGE_BITS)))]
    bits: u32,
    /// Extractor file to write; the learning curve goes beside it, with the extension csv
    ///
    /// An interrupted run leaves a checkpoint beside it, from which the same command goes on with --resume.
    #[arg(long)]
    out: PathBuf,
    /// Public seed of scenes, views and offsets
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Clips of each scene
    #[arg(long, default_value_t = 24)]
    train_clips: u32,
    /// Random offset fields on each scene
    #[arg(long, default_value_t = 32)]
    responses: u32,
    /// Side of the frames in pixels
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
    /// Go on from the checkpoint of an interrupted run
    #[arg(long)]
    resume: bool,
    /// Replace an existing file
    #[arg(short = 'w', long)]
    overwrite: bool,
}

pub(super) fn run(args: &PretrainArgs, host: &dyn Host) -> Result<(), EngineError> {
    host.listen();
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    // An hour of training must not end at a place that cannot be written.
    drop(AtomicFile::create(&args.out, existing)?);
    let device = host.open()?;
    let clip = ClipModel::load(&device, &ClipSource::from_argument(&args.clip))?;
    let config = config(args);
    let progress = host.progress(config.num_scenes() as u64);
    let mut training = Pretraining::prepare(&device, &clip, config)?;
    let checkpoint = checkpoint::path_beside(&args.out);
    if args.resume {
        training.restore(&checkpoint)?;
    }
    while let Some(report) = training.step()? {
        progress.set_position(report.number as u64);
        progress.set_message(format!("separation {:.1} %", 100.0 * report.separation));
        training.save(&checkpoint)?;
        if host.is_stopped() {
            progress.abandon();
            return Err(EngineError::Interrupted { checkpoint });
        }
    }
    progress.finish_and_clear();
    let pretrained = training.extractor(command(args))?;
    AtomicFile::write(&args.out.with_extension("csv"), Existing::Replace, curve(training.reports()).as_bytes())?;
    pretrained.write(&args.out, existing)?;
    checkpoint::remove(&checkpoint);
    host.note(&format!("wrote {}, {}", args.out.display(), pretrained.digest()?));
    Ok(())
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
        "guard4d lab pretrain --scenes {scenes} --bits {bits} --seed {seed} --train-clips {train_clips} \
         --responses {responses} --size {size}"
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
