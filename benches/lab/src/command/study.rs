//! `guard4d lab study`

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum as _};
use guard4d_engine::base::files::bad_data;
use guard4d_engine::base::ledger::read;
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::fidelity::DEFAULT_PSNR_DB;
use guard4d_engine::networks::clip::ClipSource;
use guard4d_engine::networks::lpips::LpipsWeights;
use guard4d_engine::watermark::embed::WeightsFile;
use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;
use serde_json::json;

use super::host::Host;
use super::locating::{self, LocatingArgs};
use super::tracing::{self, Part, TracingArgs};
use crate::locating::attack::Attack;
use crate::locating::measure::LocatedRow;
use crate::locating::pages as leaks;
use crate::study::{SUBSTUDIES, Scale, SceneSource, Step, Study, Substudy, redraw, substudies_in};
use crate::tracing::measure::Reading;
use crate::tracing::pages;

/// The word for all parts.
const ALL: &str = "all";
/// Parts that are made of stamped copies instead of embeddings, each with a page of its name.
const OF_COPIES: [Copies; 3] = [
    Copies { name: "stamping", about: "Stamped copies, at several strengths", part: Part::Stamping },
    Copies { name: "tracing", about: "Stamped copies, in all films", part: Part::Films },
    Copies { name: "collusion", about: "Stamped copies that were mixed", part: Part::Collusion },
];
/// Readings of copies, in the folder of a study.
const COPIES_CSV: &str = "copies.csv";
const LEAKS_CSV: &str = "leaks.csv";
const LEAKS: &str = "the readings of a study's leaks, as it writes them";
/// Films of each asset that leak, and for a quick look.
const LEAKS_OF_EACH: u64 = 10;
const QUICK_LEAKS: u64 = 1;
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
    #[arg(required = true, value_parser = words())]
    what: Vec<Word>,
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

/// One part of a study.
#[derive(Clone, Copy, Debug)]
enum Measured {
    Marks(Substudy),
    Copies(Copies),
    /// Copies that leaked in films of which nothing else is known.
    Leaks,
}

impl Measured {
    fn name(&self) -> &'static str {
        match self {
            Self::Marks(part) => part.name,
            Self::Copies(part) => part.name,
            Self::Leaks => leaks::NAME,
        }
    }

    fn about(&self) -> &'static str {
        match self {
            Self::Marks(part) => part.about,
            Self::Copies(part) => part.about,
            Self::Leaks => "Stamped copies in films from unknown cameras",
        }
    }

    /// All, in the order in which they are measured.
    fn all() -> impl Iterator<Item = Self> {
        SUBSTUDIES.into_iter().map(Self::Marks).chain(OF_COPIES.map(Self::Copies)).chain([Self::Leaks])
    }
}

/// What is asked for by one word.
#[derive(Clone, Copy, Debug)]
enum Word {
    All,
    One(Measured),
}

fn words() -> impl TypedValueParser<Value = Word> {
    let known = Measured::all().map(|part| PossibleValue::new(part.name()).help(part.about()));
    let words = PossibleValuesParser::new(known.chain([PossibleValue::new(ALL).help("All of them")]));
    words.map(|word| Measured::all().find(|part| part.name() == word).map_or(Word::All, Word::One))
}

pub(super) fn run(args: &StudyArgs, host: &dyn Host) -> Result<(), EngineError> {
    host.listen();
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let written = match &args.redraw {
        Some(rows) => redraw_parts(args, rows, &command)?,
        None => {
            let asked = Asked::of(args);
            let mut written = match &asked.of_marks[..] {
                [] => Vec::new(),
                marks => measure_marks(args, marks, command.clone(), host)?,
            };
            if !asked.of_copies.is_empty() {
                written.extend(measure_copies(args, &asked.of_copies, &command, host)?);
            }
            if asked.of_leaks {
                written.push(measure_leaks(args, &command, host)?);
            }
            written
        }
    };
    let words: Vec<String> = written.iter().map(|page| page.display().to_string()).collect();
    host.print(&json!({ "pages": words }), &words.join("\n"))
}

/// What is asked for, once each.
struct Asked {
    of_marks: Vec<Substudy>,
    of_copies: Vec<Copies>,
    of_leaks: bool,
}

impl Asked {
    fn of(args: &StudyArgs) -> Self {
        let is_asked = |name: &str| {
            args.what.iter().any(|word| match word {
                Word::All => true,
                Word::One(part) => part.name() == name,
            })
        };
        Self {
            of_marks: SUBSTUDIES.into_iter().filter(|part| is_asked(part.name)).collect(),
            of_copies: OF_COPIES.into_iter().filter(|part| is_asked(part.name)).collect(),
            of_leaks: is_asked(leaks::NAME),
        }
    }

    /// Those of which a table has rows.
    fn of_table(rows: &Path) -> Result<Self, EngineError> {
        let mut all = Self { of_marks: substudies_in(rows)?, of_copies: Vec::new(), of_leaks: false };
        if all.of_marks.is_empty() {
            all.of_leaks = read::<LocatedRow>(rows, LEAKS).is_ok();
            // What is none of all is refused as the last.
            all.of_copies = if all.of_leaks { Vec::new() } else { OF_COPIES.to_vec() };
        }
        Ok(all)
    }
}

/// Makes pages again. All parts are those that `rows` has.
fn redraw_parts(args: &StudyArgs, rows: &Path, command: &str) -> Result<Vec<PathBuf>, EngineError> {
    let all = args.what.iter().any(|word| matches!(word, Word::All));
    let asked = if all { Asked::of_table(rows)? } else { Asked::of(args) };
    let of_marks = asked.of_marks.iter().map(|part| redraw(part, rows, &args.out, command));
    let mut written = of_marks.collect::<Result<Vec<_>, _>>()?;
    if !asked.of_copies.is_empty() {
        let readings: Vec<Reading> = read(rows, "the readings of a study's copies, as it writes them")?;
        let pages = pages_of(&asked.of_copies, &args.out, &readings, command, Vec::new())?;
        let missing = asked.of_copies.iter().find(|part| !all && !is_among(part, &pages));
        if let Some(Copies { name, .. }) = missing {
            return Err(bad_data(rows, "readings", format!("none of `{name}`"), "one at least"));
        }
        written.extend(pages);
    }
    if asked.of_leaks {
        let (readings, pictures) = (read(rows, LEAKS)?, rows.with_file_name(leaks::NAME));
        written.push(leaks::write(&args.out, &readings, &pictures, command, Vec::new())?);
    }
    Ok(written)
}

fn measure_marks(
    args: &StudyArgs,
    what: &[Substudy],
    command: String,
    host: &dyn Host,
) -> Result<Vec<PathBuf>, EngineError> {
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

fn measure_copies(
    args: &StudyArgs,
    parts: &[Copies],
    command: &str,
    host: &dyn Host,
) -> Result<Vec<PathBuf>, EngineError> {
    let device = host.open()?;
    let table = tracing::measure(&tracing_args(args, parts)?, &device, host)?;
    pages_of(parts, &args.out, table.rows(), command, vec![device.info().name.clone()])
}

/// Writes the pages of some parts.
fn pages_of(
    parts: &[Copies],
    out: &Path,
    readings: &[Reading],
    command: &str,
    devices: Vec<String>,
) -> Result<Vec<PathBuf>, EngineError> {
    let written = pages::write(out, readings, command, devices)?;
    let is_asked = |page: &PathBuf| parts.iter().any(|part| is_among(part, std::slice::from_ref(page)));
    Ok(written.into_iter().filter(is_asked).collect())
}

fn is_among(part: &Copies, pages: &[PathBuf]) -> bool {
    pages.iter().any(|page| page.file_stem().is_some_and(|stem| stem == part.name))
}

/// Measures leaks and writes their page.
fn measure_leaks(args: &StudyArgs, command: &str, host: &dyn Host) -> Result<PathBuf, EngineError> {
    let device = host.open()?;
    let pictures = args.out.join(leaks::NAME);
    let Scale { scenes, quick, .. } = scale(args)?;
    let is_wanted = |attack: &Attack| {
        let name = attack.name();
        if args.only.is_empty() { !quick } else { args.only.iter().any(|word| name.contains(word.as_str())) }
    };
    let attack: Vec<Attack> = Attack::value_variants().iter().copied().filter(is_wanted).collect();
    let asked = LocatingArgs {
        models: scenes,
        films: if quick { QUICK_LEAKS } else { LEAKS_OF_EACH },
        first: 0,
        attack: if attack.is_empty() { vec![Attack::None] } else { attack },
        other: None,
        frames: if quick { QUICK_FRAMES } else { FRAMES },
        out: args.out.join(LEAKS_CSV),
        pictures: Some(pictures.clone()),
    };
    let table = locating::measure(&asked, &device, host)?;
    leaks::write(&args.out, table.rows(), &pictures, command, vec![device.info().name.clone()])
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
