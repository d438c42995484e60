//! `guard4d lab study`

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipSource;
use guard4d_engine::networks::lpips::LpipsWeights;
use guard4d_engine::watermark::embed::WeightsFile;
use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;
use serde_json::json;

use super::host::Host;
use crate::study::{SUBSTUDIES, Scale, SceneSource, Step, Study, Substudy, redraw};

/// The word for all parts.
const ALL: &str = "all";
/// Flags that say how to measure.
const MEASURING: [&str; 11] =
    ["quick", "scenes", "seeds", "only", "size", "steps", "train_clips", "probes", "rotations", "pretrained", "lpips"];

#[derive(Args, Debug)]
pub(super) struct StudyArgs {
    /// What to measure
    #[arg(required = true, value_parser = parts())]
    what: Vec<Parts>,
    /// Folder for readings, keys and reports; what is there is gone on with
    #[arg(long)]
    out: PathBuf,
    /// Measure nothing: make the reports again from rows that a study left, OUT/PART.csv
    ///
    /// Rows of several parts may stand in one file, with a column `part` for their names.
    #[arg(long, value_name = "CSV", conflicts_with_all = MEASURING)]
    redraw: Option<PathBuf>,
    /// Small frames, few steps and fewer arms: each part ends within 15 minutes on two processor cores
    #[arg(long)]
    quick: bool,
    /// Scenes: demo, or models as `inspect` can read them [default: demo]
    #[arg(long, value_delimiter = ',')]
    scenes: Vec<SceneSource>,
    /// Seeds of keys, messages, views, times and noise [default: 0,1,2; with --quick: 0]
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u8).range(..=253))]
    seeds: Vec<u8>,
    /// Only arms whose name holds one of these words
    #[arg(long, value_name = "WORDS", value_delimiter = ',')]
    only: Vec<String>,
    /// Side of frames in pixels [default: 400; with --quick: 100]
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: Option<u32>,
    /// Training steps instead of the profile's
    #[arg(long)]
    steps: Option<u32>,
    /// Training clips instead of the profile's
    #[arg(long)]
    train_clips: Option<u32>,
    /// Random offset fields that the calibration is fitted to, instead of the profile's
    #[arg(long)]
    probes: Option<u32>,
    /// Rotations of the key that are tried before the best for the message is taken, with `blind` and `pretrained`;
    /// every p-value is multiplied by them
    #[arg(long, value_name = "K")]
    rotations: Option<u32>,
    /// CLIP checkpoint: `mini` or a folder
    #[arg(long, default_value = "mini")]
    clip: String,
    /// Pretrained extractor, as `embed` takes it
    #[arg(long, value_name = "FILE")]
    pretrained: Option<PathBuf>,
    /// LPIPS weights, as `embed` takes them: part of the paper's objective, and one more figure of its rows
    #[arg(long, value_name = "FILE")]
    lpips: Option<PathBuf>,
}

/// The sub-studies that one word names.
#[derive(Clone, Debug)]
struct Parts(Vec<Substudy>);

/// Reads a part's name, or the word for all of them.
fn parts() -> impl TypedValueParser<Value = Parts> {
    let one = |part: Substudy| PossibleValue::new(part.name).help(part.about);
    let words = SUBSTUDIES.map(one).into_iter().chain([PossibleValue::new(ALL).help("All of them")]);
    PossibleValuesParser::new(words).try_map(|word| match word.as_str() {
        ALL => Ok(Parts(SUBSTUDIES.to_vec())),
        name => name.parse().map(|part| Parts(vec![part])),
    })
}

pub(super) fn run(args: &StudyArgs, host: &dyn Host) -> Result<(), EngineError> {
    let mut what: Vec<Substudy> = args.what.iter().flat_map(|parts| parts.0.clone()).collect();
    what.dedup_by_key(|part| part.name);
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let pages = match &args.redraw {
        Some(rows) => what.iter().map(|part| redraw(part, rows, &args.out, &command)).collect::<Result<Vec<_>, _>>()?,
        None => measure(args, &what, command, host)?,
    };
    let words: Vec<String> = pages.iter().map(|page| page.display().to_string()).collect();
    host.print(&json!({ "pages": words }), &words.join("\n"))
}

fn measure(args: &StudyArgs, what: &[Substudy], command: String, host: &dyn Host) -> Result<Vec<PathBuf>, EngineError> {
    host.listen();
    let open = || host.open();
    let study = Study {
        scale: scale(args)?,
        clip: ClipSource::from_argument(&args.clip),
        open: &open,
        out: args.out.clone(),
        command,
    };
    study.run(what, &mut |step| {
        if let Step::Embedding { cell, index, len } = step {
            let seed = cell.arm.config.seed;
            host.note(&format!("{}/{len} {}: {}, seed {seed}", index + 1, cell.scene, cell.arm.name));
        }
        if host.is_stopped() { Err(EngineError::Stopped) } else { Ok(()) }
    })
}

fn scale(args: &StudyArgs) -> Result<Scale, EngineError> {
    let scale = if args.quick { Scale::quick() } else { Scale::full() };
    Ok(Scale {
        scenes: if args.scenes.is_empty() { scale.scenes } else { args.scenes.clone() },
        seeds: if args.seeds.is_empty() { scale.seeds } else { args.seeds.clone() },
        size_px: args.size.unwrap_or(scale.size_px),
        steps: args.steps.map(|steps| steps as usize).or(scale.steps),
        clips: args.train_clips.or(scale.clips),
        probes: args.probes.map(|probes| probes as usize).or(scale.probes),
        rotations: args.rotations.or(scale.rotations),
        pretrained: pretrained(args)?,
        lpips: args.lpips.as_deref().map(|path| WeightsFile::of(Arc::new(LpipsWeights::read(path)?))).transpose()?,
        quick: scale.quick,
        only: args.only.clone(),
    })
}

/// The one that is named, or the built-in one with the built-in CLIP.
fn pretrained(args: &StudyArgs) -> Result<Option<WeightsFile<PretrainedExtractor>>, EngineError> {
    let is_mini = matches!(ClipSource::from_argument(&args.clip), ClipSource::Mini);
    if args.pretrained.is_none() && !is_mini {
        return Ok(None);
    }
    WeightsFile::of(Arc::new(PretrainedExtractor::open(args.pretrained.as_deref())?)).map(Some)
}
