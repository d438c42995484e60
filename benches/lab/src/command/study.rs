//! `guard4d lab study`

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use guard4d_engine::base::files::read_file;
use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::fidelity::DEFAULT_PSNR_DB;
use guard4d_engine::networks::clip::ClipSource;
use guard4d_engine::networks::lpips::LpipsWeights;
use guard4d_engine::watermark::embed::WeightsFile;
use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;
use serde_json::json;

use super::host::Host;
use super::tracing::{self, Part, TracingArgs};
use crate::study::{SUBSTUDIES, Scale, SceneSource, Step, Study, Substudy, redraw};
use crate::tracing::measure::Reading;
use crate::tracing::pages;

/// The word for all parts.
const ALL: &str = "all";
/// Parts that are made of stamped copies instead of embeddings, each with a page of its name.
const COPIES: [Copies; 3] = [
    Copies { name: "stamping", about: "Stamped copies, at several strengths", part: Part::Stamping },
    Copies { name: "tracing", about: "Stamped copies, in all films", part: Part::Films },
    Copies { name: "collusion", about: "Stamped copies that were mixed", part: Part::Collusion },
];
/// Readings of copies, in the folder of a study.
const COPIES_CSV: &str = "copies.csv";
/// Frames of a film of a copy, and their side, px; and the same for a quick look, which is taken at some films only.
const FRAMES: u32 = 24;
const SIDE_PX: u32 = 400;
const QUICK_FRAMES: u32 = 8;
const QUICK_SIDE_PX: u32 = 200;
const QUICK_FILMS: [&str; 2] = ["png", "h264"];
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
    /// Only arms, and films of copies, whose name holds one of these words
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

/// A part that is made of stamped copies.
#[derive(Clone, Copy, Debug)]
struct Copies {
    name: &'static str,
    about: &'static str,
    part: Part,
}

/// What one word names.
#[derive(Clone, Debug)]
struct Parts {
    of_marks: Vec<Substudy>,
    of_copies: Vec<Copies>,
}

/// Reads a part's name, or the word for all of them.
fn parts() -> impl TypedValueParser<Value = Parts> {
    let known = SUBSTUDIES.map(|part| PossibleValue::new(part.name).help(part.about)).into_iter();
    let copies = COPIES.map(|part| PossibleValue::new(part.name).help(part.about));
    let words = known.chain(copies).chain([PossibleValue::new(ALL).help("All of them")]);
    PossibleValuesParser::new(words).try_map(|word| {
        let copies = |is_it: &dyn Fn(&Copies) -> bool| COPIES.into_iter().filter(|part| is_it(part)).collect();
        match word.as_str() {
            ALL => Ok(Parts { of_marks: SUBSTUDIES.to_vec(), of_copies: copies(&|_| true) }),
            name if COPIES.iter().any(|part| part.name == name) => {
                Ok(Parts { of_marks: Vec::new(), of_copies: copies(&|part| part.name == name) })
            }
            name => name.parse().map(|part| Parts { of_marks: vec![part], of_copies: Vec::new() }),
        }
    })
}

pub(super) fn run(args: &StudyArgs, host: &dyn Host) -> Result<(), EngineError> {
    let mut what: Vec<Substudy> = args.what.iter().flat_map(|parts| parts.of_marks.clone()).collect();
    what.dedup_by_key(|part| part.name);
    let mut copies: Vec<Copies> = args.what.iter().flat_map(|parts| parts.of_copies.clone()).collect();
    copies.dedup_by_key(|part| part.name);
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    host.listen();
    let mut written = match &args.redraw {
        Some(rows) => what.iter().map(|part| redraw(part, rows, &args.out, &command)).collect::<Result<Vec<_>, _>>()?,
        None if what.is_empty() => Vec::new(),
        None => measure(args, &what, command.clone(), host)?,
    };
    if !copies.is_empty() {
        written.extend(of_copies(args, &copies, &command, host)?);
    }
    let words: Vec<String> = written.iter().map(|page| page.display().to_string()).collect();
    host.print(&json!({ "pages": words }), &words.join("\n"))
}

fn measure(args: &StudyArgs, what: &[Substudy], command: String, host: &dyn Host) -> Result<Vec<PathBuf>, EngineError> {
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

/// Measures stamped copies, or reads what was measured, and writes their pages.
fn of_copies(args: &StudyArgs, parts: &[Copies], command: &str, host: &dyn Host) -> Result<Vec<PathBuf>, EngineError> {
    let written = match &args.redraw {
        Some(rows) => {
            // A table that is not there would be begun.
            read_file(rows, "the readings of a study's copies, as it writes them")?;
            pages::write(&args.out, Ledger::<Reading>::open(rows)?.rows(), command, Vec::new())?
        }
        None => {
            let device = host.open()?;
            let table = tracing::measure(&tracing_args(args, parts)?, &device, host)?;
            pages::write(&args.out, table.rows(), command, vec![device.info().name.clone()])?
        }
    };
    let is_asked = |page: &PathBuf| parts.iter().any(|part| page.file_stem().is_some_and(|stem| stem == part.name));
    Ok(written.into_iter().filter(is_asked).collect())
}

/// What `lab tracing` would be asked for.
fn tracing_args(args: &StudyArgs, parts: &[Copies]) -> Result<TracingArgs, EngineError> {
    let Scale { scenes, seeds, quick, .. } = scale(args)?;
    let films = match args.only.is_empty() && quick {
        true => QUICK_FILMS.map(str::to_owned).to_vec(),
        false => args.only.clone(),
    };
    Ok(TracingArgs {
        models: scenes,
        part: parts.iter().map(|part| part.part).collect(),
        keys: u8::try_from(seeds.len()).unwrap_or(u8::MAX),
        films,
        frames: if quick { QUICK_FRAMES } else { FRAMES },
        side: args.size.unwrap_or(if quick { QUICK_SIDE_PX } else { SIDE_PX }),
        target_psnr: DEFAULT_PSNR_DB,
        out: args.out.join(COPIES_CSV),
        splat_transform: None,
        page: None,
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
