//! `guard4d demo`: the whole way on the embedded scene, with nothing to download.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use guard4d_engine::EngineError;
use guard4d_engine::clip::ClipSource;
use guard4d_engine::demo::{self, BITS, Scene};
use guard4d_engine::media::Frame;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::frames::write_png_folder;
use guard4d_engine::output::{AtomicDir, Existing};
use guard4d_engine::scene::{CameraSet, Model};
use guard4d_engine::watermark::delivery::{self, Delivery, MARKED, PRIVATE, RECEIPT};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, Subject};
use guard4d_engine::watermark::evaluate::{Evaluation, HeldOut, mean_accuracy, read_clips};
use guard4d_engine::watermark::extractor::Reader;
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::prf::MasterSecret;
use guard4d_engine::watermark::verify::{Case, Exhibits, Report, Sought, clean_clips};
use serde::Serialize;

use crate::args::{Common, DemoArgs};
use crate::media::{ffmpeg, read_options};
use crate::report::{Outcome, cost_rows, evidence_in_words, note, percent, print, reading_rows, table};
use crate::{devices, embed, stop, verify};

/// How receipts name the embedded scene; the folder that it is unpacked to has no name of its own.
const INPUT: &str = "demo-scene";
/// The marked film, which is verified.
const VIDEO: &str = "marked.mp4";

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
    verification: &'a Report,
}

/// Shares of bits right when the marked clips are read with another key and the owner's extractor.
#[derive(Clone, Copy, Debug, Serialize)]
struct WrongKey {
    /// Of the other key's own message: chance, unless any key fires on any clip.
    own_message: f64,
    /// Of the owner's message. The extractor knows where in CLIP's space each bit lies, so this is what it gives away.
    owners_message: f64,
}

/// The delivery's worth on held-out frames, and those frames as films: one list per clip.
struct Film {
    evaluation: Evaluation,
    marked: Vec<Vec<Frame>>,
    clean: Vec<Vec<Frame>>,
}

pub(crate) fn run(args: &DemoArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    let out = AtomicDir::create(&args.out, existing)?;
    let device = devices::open(common)?;
    note(common, &format!("device: {}", device.info().name));
    let clip = devices::load_clip(&device, &ClipSource::Mini, common)?;
    let scene = Scene::unpack()?;
    let model = Model::open(scene.path())?;
    let config = config(args);
    let mut seconds = BTreeMap::new();
    let key = |path: Option<&Path>| match path {
        Some(path) => Key::read(path, &clip),
        None => Ok(Key::generate(&device, &clip, MasterSecret::generate()?, BITS)?.0),
    };

    note(common, "1/4 key: a bit-to-token table and a message decoder, from a fresh master secret");
    let owner = timed(&mut seconds, "key", || key(args.short.key.as_deref()))?;
    owner.write(&out.path().join("owner.key"), Existing::Refuse)?;

    note(common, "2/4 embed: small colour offsets on the splats");
    let message = owner.own_message();
    let subject = Subject { device: &device, clip: &clip, key: &owner, model: &model, message: &message };
    stop::check()?;
    let embedding = Embedding::prepare(subject, config.clone())?;
    let embedded = embed::train(embedding, common, None)?;
    seconds.extend(embedded.seconds.clone());

    note(common, "3/4 render: 8-bit frames of views and times that training never saw");
    let mut cameras = scene.cameras(config.size_px)?;
    cameras.views.truncate(args.short.frames.unwrap_or(usize::MAX));
    let delivery = Delivery { subject, config: &config, embedded: &embedded, input: Path::new(INPUT), payload: None };
    let film = timed(&mut seconds, "render", || shoot(&delivery, &cameras, out.path()))?;

    stop::check()?;
    note(common, "4/4 verify: from the video alone");
    let receipt = out.path().join(PRIVATE).join(RECEIPT);
    let sought = Some(Sought::Message(message));
    let case = Case { device: &device, clip: &clip, key: &owner, sought, receipt: &receipt, general: None };
    let exhibits = Exhibits { suspects: vec![out.path().join(VIDEO)], clean: film.clean, ..Exhibits::default() };
    let verification = timed(&mut seconds, "verify", || case.verify(&exhibits, &read_options()))?;

    stop::check()?;
    let wrong_key = timed(&mut seconds, "wrong key", || {
        let other = key(args.short.wrong_key.as_deref())?;
        read_with(&other, subject, &embedded, &film.marked)
    })?;
    // What was made is kept, whatever becomes of the text about it.
    out.commit()?;
    let evaluation = &film.evaluation;
    let evidence = evidence_in_words(evaluation.mode, evaluation.mixing.of > 1);
    let (seconds, verification, peak_memory_bytes) = (&seconds, &verification, device.memory_use().peak_reserved_bytes);
    let result = Printed { evaluation, evidence, wrong_key, seconds, peak_memory_bytes, verification };
    print(common, &result, human)?;
    note(common, &format!("\nframes, videos, key and receipt are in {}", args.out.display()));
    Ok(verify::outcome(verification))
}

/// The demonstration's settings with what flags change.
fn config(args: &DemoArgs) -> EmbedConfig {
    let mut config = EmbedConfig { seed: args.seed, ..demo::config() };
    embed::spend(&args.short.effort, &mut config);
    config.size_px = args.short.size.unwrap_or(config.size_px);
    config
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
fn shoot(delivery: &Delivery<'_>, cameras: &CameraSet, out: &Path) -> Result<Film, EngineError> {
    let (evaluation, HeldOut { clean, .. }) = delivery::write(out, delivery, cameras)?;
    stop::check()?;
    let marked = clean_clips(delivery.subject.device, &Model::open(&out.join(MARKED))?, cameras)?;
    for (name, video, clips) in [("marked-frames", VIDEO, &marked), ("clean-frames", "clean.mp4", &clean)] {
        let frames = clips.concat();
        write_png_folder(&out.join(name), &frames)?;
        let options = EncodeOptions { ffmpeg: ffmpeg(), ..EncodeOptions::default() };
        write_video(&out.join(video), &frames, &options)?;
    }
    Ok(Film { evaluation, marked, clean })
}

/// What someone with another key reads from the marked clips when the owner's extractor is lent to them.
fn read_with(
    other: &Key,
    subject: Subject<'_>,
    embedded: &Embedded,
    marked: &[Vec<Frame>],
) -> Result<WrongKey, EngineError> {
    let mut reader = Reader::new(subject.device, subject.clip, other, &embedded.extractor)?;
    let readings = read_clips(&mut reader, marked, other.bits())?;
    Ok(WrongKey {
        own_message: mean_accuracy(&readings, &other.own_message())?,
        owners_message: mean_accuracy(&readings, subject.message)?,
    })
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
    format!("{}\n\nreading {VIDEO}:\n{}", table(&rows.concat()), verify::human(result.verification))
}
