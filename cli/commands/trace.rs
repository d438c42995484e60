//! `guard4d trace`

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::PoisonError;

use clap::Args;
use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::detect::exhibit::Beside;
use guard4d_engine::detect::gathered::{Gathered, KnownFilm, gather, gather_asset};
use guard4d_engine::detect::trace::{DEFAULT_FPR, Report, TraceRequest, judge};
use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::locate::finding::{DEFAULT_FRAMES, Wanted};
use guard4d_engine::locate::views::Vantage;
use guard4d_engine::media::FrameSource;
use guard4d_engine::release::issue_root::root_of;
use guard4d_engine::release::ledger::Ledger;
use guard4d_engine::scene::recognise::is_model;
use guard4d_engine::scene::{CameraSet, FrameSize};

use crate::flags::common::Common;
use crate::flags::near::NearArgs;
use crate::flags::overwrite::Overwrite;
use crate::shared::farm_job::FarmJob;
use crate::shared::media::read_options;
use crate::shared::{device, locator, model};
use crate::ui::document::{Part, Repeat, TraceDocument};
use crate::ui::outcome::Outcome;
use crate::ui::progress::{ObserverBar, bar};
use crate::ui::report::print;
use crate::ui::stop;
use crate::ui::tracing_report::human;

/// What leaked, and what it is compared with.
#[derive(Args, Debug)]
pub(crate) struct TraceArgs {
    /// Films of one leak, or one leaked asset
    ///
    /// A film is a folder of PNG, JPEG or OpenEXR frames, or a video. Films add up.
    #[arg(required = true, value_name = "LEAK")]
    leaks: Vec<PathBuf>,
    /// The model that copies were stamped from
    #[arg(long, value_name = "MODEL")]
    original: PathBuf,
    /// The issue's ledger
    #[arg(long, value_name = "FILE")]
    ledger: PathBuf,
    /// Camera and time of each frame, as `render --save-cameras` and `locate` write them; once for each film
    ///
    /// Without them each film is looked at as `locate` does. That sees the film and the original alone, and no key.
    #[arg(long, value_name = "FILE", conflicts_with = "near")]
    cameras: Vec<PathBuf>,
    /// Where no cameras are given: look at this many frames of each film at most, evenly spread
    #[arg(long, value_name = "N", default_value_t = NonZeroU32::new(DEFAULT_FRAMES).expect("more than none"))]
    max_frames: NonZeroU32,
    #[command(flatten)]
    near: NearArgs,
    /// Largest probability that anybody is named by chance
    #[arg(long, value_name = "P", default_value_t = DEFAULT_FPR)]
    fpr: f64,
    /// Score numbers up to this, where the ledger was lost and knows fewer
    #[arg(long, value_name = "N", default_value_t = 0)]
    copies: u64,
    /// Write the answer as a page for people: one HTML file that needs no other and no network
    ///
    /// It shows who is named, how rare that is by chance, frames beside the original, hashes, and how somebody else
    /// repeats it.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    report: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "trace",
    has_input: true,
    needs_device: true,
    arguments: |row, _| vec!["--".to_owned(), row.input.clone()],
    reserved: &["overwrite"],
    keep: |path, report| {
        let text = serde_json::to_vec_pretty(&report).expect("it came as JSON");
        AtomicFile::write(path, Existing::Replace, &text)?;
        // Who is named is in the file alone.
        Ok(serde_json::json!({ "verdict": report["verdict"], "best_score": report["best_score"] }))
    },
    trial: None,
};

pub(crate) fn run(args: &TraceArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    if !(args.fpr > 0.0 && args.fpr < 1.0) {
        return Err(EngineError::Usage {
            what: "--fpr".to_owned(),
            got: args.fpr.to_string(),
            expected: "a probability between 0 and 1".to_owned(),
        });
    }
    // Whether it may be written is known before the films are read.
    let page = args.report.as_deref().map(|path| AtomicFile::create(path, args.overwrite.existing())).transpose()?;
    let ledger = Ledger::open(&args.ledger)?;
    let original = model::open_in_kind(&args.original, common)?;
    ledger.check_original(original.digest(), original.gaussians.len())?;
    let issue = Issue::new(&original, ledger.prf(), ledger.terms().strength);
    let device = device::open(common)?;
    let mut leak = match args.leaks.as_slice() {
        [asset] if is_model(asset)? => {
            let gathered = gather_asset(&issue, asset, &model::open_in_kind(asset, common)?)?;
            Leak { gathered, beside: Vec::new() }
        }
        films => read_films(films, args, &Tracer { device: &device, issue: &issue }, common)?,
    };
    let request = TraceRequest { device: &device, issue: &issue, ledger: &ledger, copies: args.copies, fpr: args.fpr };
    let report: Report = judge(&request, &mut leak.gathered)?;
    if let Some(page) = page {
        let document = TraceDocument {
            report: &report,
            beside: &leak.beside,
            parts: &parts(args, original.digest())?,
            root: root_of(&ledger)?.root(),
            repeat: Repeat::now(&device),
        };
        page.finish(document.html()?.as_bytes())?;
    }
    print(common, &report, human)?;
    Ok(Outcome::Traced(report.verdict))
}

/// What was read, by its hashes.
fn parts(args: &TraceArgs, original: Digest) -> Result<Vec<Part>, EngineError> {
    let of = |what| move |path: &PathBuf| Ok(Part { what, path: path.clone(), hash: Digest::of_path(path)? });
    let leaks = args.leaks.iter().map(of("leak"));
    let cameras = args.cameras.iter().map(of("cameras"));
    let original = Part { what: "original", path: args.original.clone(), hash: original };
    leaks.chain(cameras).chain(std::iter::once(Ok(original))).collect()
}

/// What a leak says, and frames to show of it.
struct Leak {
    gathered: Gathered,
    beside: Vec<Beside>,
}

/// What films are compared with, and on what.
struct Tracer<'a> {
    device: &'a Device,
    issue: &'a Issue<'a>,
}

fn read_films(paths: &[PathBuf], args: &TraceArgs, tracer: &Tracer<'_>, common: &Common) -> Result<Leak, EngineError> {
    let Tracer { device, issue } = *tracer;
    if !args.cameras.is_empty() && args.cameras.len() != paths.len() {
        return Err(EngineError::Usage {
            what: "--cameras".to_owned(),
            got: format!("{} for {} films", args.cameras.len(), paths.len()),
            expected: "one for each film, in their order, or none at all".to_owned(),
        });
    }
    let open = |path: &PathBuf| FrameSource::open(path, &read_options());
    let sources = paths.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let pairs = || paths.iter().zip(&sources);
    let (mut films, mut located) = (Vec::new(), Vec::new());
    if args.cameras.is_empty() {
        let near = locator::near(&args.near)?;
        let shared = locator::of(device, issue.model(), Vantage::of(&near), common)?;
        let mut locator = shared.lock().unwrap_or_else(PoisonError::into_inner);
        for (path, source) in pairs() {
            let mut progress = ObserverBar::new(common);
            let options = read_options();
            let wanted = Wanted { model: issue.model(), path, options: &options, most: args.max_frames };
            let found = locator.film(wanted, None, &mut progress)?;
            located.push(found.report);
            films.extend(found.cameras.map(|cameras| KnownFilm::new(path, source, &cameras)).transpose()?);
        }
    } else {
        for ((path, source), cameras) in pairs().zip(&args.cameras) {
            let (width, height) = source.size_px()?;
            films.push(KnownFilm::new(path, source, &CameraSet::open(cameras, FrameSize::new(width, height)?)?)?);
        }
    }
    let progress = bar(common, films.iter().map(|film| film.shots.len() as u64).sum());
    let mut gathered = gather(device, issue, &films, &mut || {
        progress.inc(1);
        stop::check()
    })?;
    progress.finish_and_clear();
    let beside = if args.report.is_some() { Beside::of(device, issue.model(), &films)? } else { Vec::new() };
    gathered.located = located;
    Ok(Leak { gathered, beside })
}
