//! The demonstration, step by step.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use guard4d_engine::base::output::{AtomicDir, AtomicFile, Existing};
use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::detect::report::VerifyReport;
use guard4d_engine::detect::request::{VerifyInputs, VerifyRequest};
use guard4d_engine::detect::sought::Sought;
use guard4d_engine::detect::suspect::Suspect;
use guard4d_engine::detect::trace::Report as TracingReport;
use guard4d_engine::detect::verify_cache::VerifyCache;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::media::Frame;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::release::delivery::{self, Delivery, MARKED, PRIVATE, RECEIPT};
use guard4d_engine::release::evaluate::{Evaluation, HeldOut};
use guard4d_engine::render::render_frames;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, Model};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile, Subject};
use guard4d_engine::watermark::key::owner_key::Key;
use serde::Serialize;

use super::copies::story;
use super::wrong_key::{WrongKey, read_with};
use crate::commands::embed::training::train;
use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::flags::size::parse_size;
use crate::shared::device;
use crate::shared::media::{ffmpeg, read_options};
use crate::ui::document::{Document, Repeat};
use crate::ui::outcome::Outcome;
use crate::ui::progress::ObserverBar;
use crate::ui::report::{cost_rows, evidence_in_words, note, percent, print, reading_rows, table};
use crate::ui::{stop, tracing_report, verification};

/// Where the demonstration goes.
#[derive(Args, Debug)]
pub(crate) struct DemoArgs {
    /// Folder for frames, videos, key and receipt
    #[arg(long, value_name = "DIR", default_value = "guard4d-demo")]
    out: PathBuf,
    /// Seed of cameras and noise
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    overwrite: Overwrite,
    #[command(flatten)]
    short: ShortDemoArgs,
}

/// For a demonstration that proves nothing but ends soon, as tests need it; `--help` does not show them.
#[derive(Args, Debug)]
struct ShortDemoArgs {
    /// Training steps
    #[arg(long, hide = true)]
    steps: Option<u32>,
    /// Training clips
    #[arg(long, hide = true)]
    train_clips: Option<u32>,
    /// Random offset fields that the calibration is fitted to
    #[arg(long, hide = true)]
    probes: Option<u32>,
    /// Rotations of the key that are tried
    #[arg(long, hide = true)]
    rotations: Option<u32>,
    /// Picture size WIDTHxHEIGHT
    #[arg(long, hide = true, value_parser = parse_size)]
    size: Option<(u32, u32)>,
    /// Film this many of the frames that training never saw instead of all
    #[arg(long, hide = true)]
    frames: Option<usize>,
    /// Owner key instead of a fresh one
    #[arg(long, hide = true)]
    key: Option<PathBuf>,
    /// Wrong key instead of a fresh one
    #[arg(long, hide = true)]
    wrong_key: Option<PathBuf>,
}

/// Width and height of its pictures in pixels: small ones, so that it ends soon.
const SIZE_PX: (u32, u32) = (200, 200);
/// Message bits of the demonstration.
const BITS: u32 = 16;

/// How receipts name the embedded scene; the folder that it is unpacked to has no name of its own.
const INPUT: &str = "demo-scene";
/// The marked film, which is verified.
const VIDEO: &str = "marked.mp4";
/// The verdict as a page.
const PAGE: &str = "verdict.html";
/// What verifies the film again, from within the folder.
const REPEAT: &str = "guard4d undo marked --undo private/undo.safetensors --out original && guard4d verify marked.mp4 \
                      --key owner.key --receipt private/receipt.json --original original --no-locate";

/// What `--json` prints.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    evidence: &'static str,
    wrong_key: WrongKey,
    seconds: &'a BTreeMap<String, f64>,
    /// Most device memory taken from the driver at one time.
    peak_memory_bytes: u64,
    verification: &'a VerifyReport,
    /// Whose copy was filmed.
    tracing: &'a TracingReport,
}

/// The delivery's worth on held-out frames, and those frames: one list per clip.
struct Rendered {
    evaluation: Evaluation,
    marked: Vec<Vec<Frame>>,
    clean: Vec<Vec<Frame>>,
}

pub(crate) fn run(args: &DemoArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let out = AtomicDir::create(&args.out, args.overwrite.existing())?;
    let device = device::open(common)?;
    note(common, &format!("device: {}", device.info().name));
    let clip = device::load_clip(&device, "mini", common)?;
    let scene = DemoScene::unpack()?;
    let model = Model::open(scene.path())?;
    let config = config(args);
    let mut seconds = BTreeMap::new();
    let key = |path: Option<&Path>| match path {
        Some(path) => Key::read(path, &clip),
        None => Ok(Key::generate(&device, &clip, MasterSecret::generate()?, BITS)?.0),
    };

    note(common, "1/5 key: a bit-to-token table and a message decoder, from a fresh master secret");
    let owner = timed(&mut seconds, "key", || key(args.short.key.as_deref()))?;
    owner.write(&out.path().join("owner.key"), Existing::Refuse)?;
    let owner = owner.for_asset(model.digest())?;

    note(common, "2/5 embed: small colour offsets on the splats");
    let message = owner.own_message();
    let subject = Subject { device: &device, clip: &clip, key: &owner, model: &model, message: &message };
    stop::check()?;
    let embedding = Embedding::prepare(subject, config.clone())?;
    let embedded = train(embedding, common, None)?;
    seconds.extend(embedded.seconds.clone());

    note(common, "3/5 render: 8-bit frames of views and times that training never saw");
    let mut cameras = scene.cameras(config.views.size_px)?;
    cameras.views.truncate(args.short.frames.unwrap_or(usize::MAX));
    let delivery = Delivery {
        subject,
        config: &config,
        embedded: &embedded,
        input: Path::new(INPUT),
        payload: None,
        class_films: 0,
    };
    let rendered = timed(&mut seconds, "render", || render(&delivery, &cameras, out.path()))?;

    stop::check()?;
    note(common, "4/5 verify: from the video alone");
    let verification = timed(&mut seconds, "verify", || verify(subject, out.path(), rendered.clean, common))?;

    stop::check()?;
    let wrong_key = timed(&mut seconds, "wrong key", || {
        read_with(&key(args.short.wrong_key.as_deref())?, subject, &embedded, &rendered.marked)
    })?;
    stop::check()?;
    note(common, "5/5 trace: a copy for each of three recipients; one is filmed from above");
    let tracing = &timed(&mut seconds, "trace", || story(&device, out.path(), config.views.size_px))?;
    // What was made is kept, whatever becomes of the text about it.
    out.commit()?;
    let evaluation = &rendered.evaluation;
    let evidence = evidence_in_words(evaluation.mode, evaluation.key_rotation.of > 1);
    let (seconds, verification, peak_memory_bytes) = (&seconds, &verification, device.memory_use().peak_reserved_bytes);
    print(
        common,
        &Printed { evaluation, evidence, wrong_key, seconds, peak_memory_bytes, verification, tracing },
        human,
    )?;
    say_where(args, common);
    Ok(Outcome::Judged(verification.verdict))
}

/// Says where everything is.
fn say_where(args: &DemoArgs, common: &Common) {
    note(common, &format!("\nframes, videos, key and receipt are in {}", args.out.display()));
    note(common, &format!("the verdict as a page: {}", args.out.join(PAGE).display()));
}

/// The demonstration's settings with what flags change.
fn config(args: &DemoArgs) -> EmbedConfig {
    let short = &args.short;
    let config = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind).with(|config| {
        config.seed = args.seed;
        config.optimiser.steps = short.steps.map_or(config.optimiser.steps, |steps| steps as usize);
        config.views.clips = short.train_clips.unwrap_or(config.views.clips);
        config.views.size_px = short.size.unwrap_or(SIZE_PX);
    });
    let probes = short.probes.map_or(config.extractor.probes(), |probes| probes as usize);
    let rotations = short.rotations.unwrap_or(config.extractor.rotations());
    config.with_probes(probes).with_rotations(rotations)
}

/// Runs one stage and notes how long it took.
fn timed<T>(
    seconds: &mut BTreeMap<String, f64>,
    stage: &str,
    work: impl FnOnce() -> Result<T, EngineError>,
) -> Result<T, EngineError> {
    let started = Instant::now();
    let done = work()?;
    seconds.insert(stage.to_owned(), started.elapsed().as_secs_f64());
    Ok(done)
}

/// Writes the marked model into `out`, and films it as it was written, beside the original.
fn render(delivery: &Delivery<'_>, cameras: &CameraSet, out: &Path) -> Result<Rendered, EngineError> {
    let (evaluation, HeldOut { clean, .. }) = delivery::write(out, delivery, cameras)?;
    stop::check()?;
    let marked = render_frames(delivery.subject.device, &Model::open(&out.join(MARKED))?, cameras)?;
    for (name, video, clips) in [("marked-frames", VIDEO, &marked), ("clean-frames", "clean.mp4", &clean)] {
        let frames = clips.concat();
        write_png_folder(&out.join(name), &frames)?;
        let options = EncodeOptions { ffmpeg: ffmpeg(), ..EncodeOptions::default() };
        write_video(&out.join(video), &frames, &options)?;
    }
    Ok(Rendered { evaluation, marked, clean })
}

/// Weighs the marked film by the receipt in `out`, and writes the verdict as a page there.
fn verify(
    subject: Subject<'_>,
    out: &Path,
    clean: Vec<Vec<Frame>>,
    common: &Common,
) -> Result<VerifyReport, EngineError> {
    let Subject { device, clip, key, model, message } = subject;
    let inputs = VerifyInputs { suspects: vec![Suspect::Video(out.join(VIDEO))], clean, ..VerifyInputs::default() };
    let request = VerifyRequest {
        device,
        clip,
        key,
        sought: Some(Sought::Message(*message)),
        receipt: &out.join(PRIVATE).join(RECEIPT),
        pretrained: None,
        original: Some(model),
        trusted_clip: None,
        claims: NonZeroU32::MIN,
        cache: &VerifyCache::default(),
    };
    let report = request.verify_observed(&inputs, &read_options(), &mut ObserverBar::new(common))?;
    let repeat = Repeat { command: REPEAT.to_owned(), device: device.info().name.clone() };
    let page = Document { report: &report, clean: &inputs.clean, repeat }.html()?;
    AtomicFile::write(&out.join(PAGE), Existing::Refuse, page.as_bytes())?;
    Ok(report)
}

fn human(result: &Printed<'_>) -> String {
    let wrong = result.wrong_key;
    let lent = "with private/extractor.safetensors in hand: keep private/ to yourself";
    let rows = [
        reading_rows(result.evaluation),
        vec![
            ("wrong key, its own message (50 % is chance)", percent(wrong.own_message)),
            ("wrong key, the owner's message", format!("{} {lent}", percent(wrong.owners_message))),
        ],
        cost_rows(result.evaluation, result.seconds, result.peak_memory_bytes),
    ];
    let (read, traced) = (verification::human(result.verification), tracing_report::human(result.tracing));
    format!("{}\n\nreading {VIDEO}:\n{read}\n\nwhose copy was filmed:\n{traced}", table(&rows.concat()))
}
