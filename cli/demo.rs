//! `guard4d demo`: the whole way on the embedded scene, with nothing to download.

use std::path::Path;
use std::time::Instant;

use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::demo::{BITS, Scene};
use guard4d_engine::media::encode::{EncodeOptions, write_mp4};
use guard4d_engine::media::frames::write_png_folder;
use guard4d_engine::output::{AtomicDir, Existing};
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::delivery::{self, Delivery, MARKED, PRIVATE, RECEIPT};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Subject};
use guard4d_engine::watermark::evaluate::mean_accuracy;
use guard4d_engine::watermark::evaluate::read_clips;
use guard4d_engine::watermark::extractor::Reader;
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::message::Payload;
use guard4d_engine::watermark::prf::MasterSecret;
use guard4d_engine::watermark::verify::{Case, Exhibits, clean_clips};

use crate::args::{Common, DemoArgs};
use crate::media::{ffmpeg, read_options};
use crate::report::{Outcome, evaluation_rows, table};
use crate::{devices, embed, stop, verify};

pub(crate) fn run(args: &DemoArgs, common: &Common) -> Result<Outcome, EngineError> {
    let talk = |text: &str| {
        if !common.quiet {
            eprintln!("{text}");
        }
    };
    stop::listen(common);
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    let out = AtomicDir::create(&args.out, existing)?;
    let device = devices::open(common)?;
    talk(&format!("device: {}", device.info().name));
    let clip = Clip::load(&device, &ClipSource::Mini)?;
    let scene = Scene::unpack()?;
    let model = Model::open(scene.path())?;

    talk("1/4 key: a bit-to-token table and a message decoder, from a fresh master secret");
    let (key, report) = Key::generate(&device, &clip, MasterSecret::generate()?, BITS)?;
    key.write(&out.path().join("owner.key"), Existing::Refuse)?;

    talk("2/4 embed: small colour offsets on the splats");
    let message = Payload::parse("random", BITS)?.message(&key.prf())?;
    let config = EmbedConfig { seed: args.seed, ..guard4d_engine::demo::config() };
    let subject = Subject { device: &device, clip: &clip, key: &key, model: &model, message: &message };
    stop::check()?;
    let embedding = Embedding::prepare(subject, config.clone())?;
    let mut embedded = embed::train(embedding, &config, common, None)?;

    talk("3/4 render: 8-bit frames of views and times that training never saw");
    let started = Instant::now();
    let cameras = scene.cameras(config.size_px)?;
    let delivery = Delivery { subject, config: &config, embedded: &embedded, input: &args.out };
    let evaluation = delivery::write(out.path(), &delivery, &cameras)?;
    stop::check()?;
    let marked = Model::open(&out.path().join(MARKED))?;
    let frames = clean_clips(&device, &marked, &cameras)?;
    let clean = clean_clips(&device, &model, &cameras)?;
    write_clip(out.path(), "marked", &frames.concat())?;
    write_clip(out.path(), "clean", &clean.concat())?;
    embedded.seconds.insert("render".to_owned(), started.elapsed().as_secs_f64());

    stop::check()?;
    talk("4/4 verify: from the video alone");
    let started = Instant::now();
    let receipt = out.path().join(PRIVATE).join(RECEIPT);
    let case = Case { device: &device, clip: &clip, key: &key, message, receipt: &receipt };
    let exhibits = Exhibits { suspects: vec![out.path().join("marked.mp4")], clean, ..Exhibits::default() };
    let verdict = case.verify(&exhibits, &read_options())?;
    let (other, _) = Key::generate(&device, &clip, MasterSecret::generate()?, BITS)?;
    let mut reader = Reader::new(&device, &clip, &other, &embedded.extractor)?;
    let wrong = Payload::parse("random", BITS)?.message(&other.prf())?;
    let wrong_key = mean_accuracy(&read_clips(&mut reader, &frames, other.bits())?, &wrong)?;
    embedded.seconds.insert("key".to_owned(), report.seconds);
    embedded.seconds.insert("verify".to_owned(), started.elapsed().as_secs_f64());

    let mut rows = evaluation_rows(&evaluation, &embedded.seconds);
    rows.insert(4, ("wrong key (50 % is chance)", format!("{:.1} %", 100.0 * wrong_key)));
    println!("{}\n\nreading marked.mp4:\n{}", table(&rows), verify::human(&verdict));
    out.commit()?;
    talk(&format!("\nframes, videos, key and receipt are in {}", args.out.display()));
    Ok(verify::outcome(&verdict))
}

fn write_clip(out: &Path, name: &str, frames: &[guard4d_engine::media::Frame]) -> Result<(), EngineError> {
    write_png_folder(&out.join(format!("{name}-frames")), frames)?;
    let options = EncodeOptions { ffmpeg: ffmpeg(), ..EncodeOptions::default() };
    write_mp4(&out.join(format!("{name}.mp4")), frames, &options)
}
