//! The promise itself: a trained key, a marked scene, H.264 films of it from cameras that training never saw, and the
//! message read from them.

use std::path::Path;

use guard4d_engine::detect::comparer::Comparer;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::id_code::SearchedP;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::evidence::statistics::chance_band;
use guard4d_engine::fingerprint::shot::Shot;
use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::release::evaluate::HeldOut;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt, Model};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, Profile, Subject};
use guard4d_engine::watermark::extractor::reader::Reader;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;

use crate::support::gpu::{Gpu, unwatched_device};
use crate::support::{has_ffmpeg, trained};

const BITS: u32 = 16;
/// Sides of the frames that are trained on, and of the films.
const SIDE_PX: [u32; 2] = [64, 128];
/// Films, and frames of each.
const SIDES: u32 = 6;
const MOMENTS: u8 = 8;
/// Least share of bits right, film by film. Seen with seeds 3, 4 and 5: 0.96, 0.99 and 0.93 for `blind`, 0.91, 0.91 and
/// 0.90 for `pretrained`. Chance comes to 0.5, and to 0.8 of 16 bits once in 100 times.
const BITS_RIGHT: f64 = 0.8;
/// The same of films from afar, aimed beside the asset, and how much of it framing gives.
const FAR_BITS_RIGHT: f64 = 0.7;
const FRAMING_GAIN: f64 = 0.1;
/// Largest p-value of all films together.
const P_VALUE: f64 = 1e-3;
/// Least fidelity. Seen: 47.6 to 48.6 dB; the mark is as strong as the default settings want it.
const PSNR_DB: f64 = 46.0;
/// Two-sided confidence of the band for films without a mark, all read as one: 16 coin flips leave it once in 1000
/// times. Seen: 7 to 12 matches.
const CONFIDENCE: f64 = 0.999;

/// Six sides from between the heights that training draws from, at moments of the whole motion.
fn cameras(place: Place) -> CameraSet {
    let lens = Lens { fov_x_rad: 0.69, size: FrameSize::new(place.side_px, place.side_px).expect("a size") };
    let look_at = LookAt::at(place.target.as_dvec3(), place.radius);
    let orbit = Orbit { views: SIDES, elevation_deg: 27.0, look_at, lens };
    let times: Vec<f32> = (0..MOMENTS).map(|i| (f32::from(i) + 0.5) / f32::from(MOMENTS)).collect();
    orbit.cameras().expect("an orbit").at_times(&times)
}

/// From where films are taken.
#[derive(Clone, Copy)]
struct Place {
    radius: f64,
    target: glam::Vec3,
    side_px: u32,
}

/// As training's views are.
const USUAL: Place = Place { radius: 4.0, target: glam::Vec3::ZERO, side_px: SIDE_PX[1] };
/// From 1.6 times the distance, aimed beside the asset.
const FAR: Place = Place { radius: 6.4, target: glam::Vec3::new(0.2, 0.1, 0.3), side_px: 200 };

/// The film as it comes back from an H.264 file at `path`.
fn through_h264(path: &Path, frames: &[Frame]) -> Vec<Frame> {
    let options = EncodeOptions { codec: Some(Codec::H264), ..EncodeOptions::default() };
    write_video(path, frames, &options).expect("encodes");
    let film = read_clip(path, &ReadOptions::default()).expect("decodes").frames().to_vec();
    assert_eq!(film.len(), frames.len(), "frames of {}", path.display());
    film
}

/// What the films of all sides say, each by itself and all together.
fn read(reader: &mut Reader, films: &[Vec<Frame>]) -> (Vec<Reading>, Reading) {
    readings(&films.iter().map(|film| reader.logits(film).expect("reads")).collect::<Vec<_>>())
}

/// What the logits of films say, each by itself and all together.
fn readings(logits: &[Vec<f32>]) -> (Vec<Reading>, Reading) {
    let of = |logits: &[f32]| Reading::from_logits(logits, BITS).expect("finite logits");
    (logits.iter().map(|film| of(film)).collect(), of(&logits.concat()))
}

/// Share of the message's bits that films show, each by itself.
fn share(films: &[Reading], message: &Message) -> f64 {
    let right = films.iter().map(|film| film.matches(message).expect("16 bits")).sum::<u32>();
    f64::from(right) / f64::from(BITS * SIDES)
}

/// What films say beside the original, each by itself and all together.
fn compare(
    gpu: &Gpu,
    reader: &mut Reader,
    model: &Model,
    films: &[Vec<Frame>],
    place: Place,
) -> (Vec<Reading>, Reading) {
    let views = settings(ExtractorMode::Blind).views;
    let mut logits = Vec::new();
    for (film, shots) in films.iter().zip(cameras(place).clips()) {
        let mut comparer = Comparer::new(gpu, model, &views).expect("frames have a size");
        assert_eq!(film.len(), shots.len(), "a camera for each frame");
        for (frame, (camera, time)) in film.iter().zip(shots) {
            comparer.push(reader, &Shot { frame, camera, time }).expect("compares");
        }
        comparer.next_film(reader).expect("compares");
        logits.push(comparer.into_logits());
    }
    readings(&logits)
}

/// Those of a short embedding.
fn settings(mode: ExtractorMode) -> EmbedConfig {
    EmbedConfig::new(Profile::Draft, mode).with(|c| {
        c.seed = 3;
        c.views.size_px = (SIDE_PX[0], SIDE_PX[0]);
        c.views.clips = 48;
        c.optimiser.steps = 400;
        c.optimiser.held_out_every = 0;
        c.open_weights().expect("what is built in is whole");
    })
}

fn embed(subject: Subject<'_>, mode: ExtractorMode) -> Embedded {
    let mut embedding = Embedding::prepare(subject, settings(mode)).expect("prepares");
    while embedding.step().expect("steps").is_some() {}
    embedding.finish().expect("finishes")
}

/// Embeds, delivers, films, reads, and fails where the mark is not read, is seen, or is read where there is none.
fn assert_read(mode: ExtractorMode) {
    let Some(gpu) = unwatched_device() else { return };
    if !has_ffmpeg() {
        return;
    }
    let clip = trained::clip(&gpu);
    let key = trained::key_of_16(&gpu, &clip);
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let message = key.own_message();
    let subject = Subject { device: &gpu, clip: &clip, key, model: &model, message: &message };
    let embedded = embed(subject, mode);

    // What counts is what the files of the marked copy hold.
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let copy = folder.path().join("marked");
    model.write_marked(&copy, &embedded.sh_coeffs).expect("writes");
    let marked = Model::open(&copy).expect("the copy opens").gaussians.sh_coeffs;
    let films = HeldOut::render(&gpu, &model, &marked, &cameras(USUAL)).expect("films");
    let psnr = films.psnr().expect("there are frames").pooled_db.0;
    let mut number = 0;
    let mut coded = |films: HeldOut| {
        let films = films.changed(|film| {
            number += 1;
            Ok(through_h264(&folder.path().join(format!("{number}.mp4")), film))
        });
        films.expect("nothing above fails in this way")
    };
    let films = coded(films);
    let far = coded(HeldOut::render(&gpu, &model, &marked, &cameras(FAR)).expect("films"));
    let mut reader = Reader::new(&gpu, &clip, key, &embedded.extractor).expect("belongs to the key");
    let (marked, all_marked) = read(&mut reader, &films.marked);
    let (_, all_clean) = read(&mut reader, &films.clean);

    let (share, clean) = (share(&marked, &message), all_clean.matches(&message).expect("16 bits"));
    let p = SearchedP::of(&all_marked, &message, 1).expect("16 bits").soft_score;
    let seen = format!("{mode:?}: {share} of the bits, p = {p}, {psnr} dB, {clean} of {BITS} without a mark");
    assert_eq!(marked.len(), SIDES as usize, "a reading of each film");
    assert!(share >= BITS_RIGHT, "{seen}; at least {BITS_RIGHT} of the bits of each film are due");
    assert!(p <= P_VALUE, "{seen}; at most {P_VALUE} is due for all films together");
    assert!(psnr >= PSNR_DB, "{seen}; at least {PSNR_DB} dB are due");
    let band = chance_band(BITS, CONFIDENCE).expect("a confidence");
    assert!(band.contains(&clean), "{seen}; {band:?} is what chance leaves");
    println!("{seen}");

    // Films that are framed otherwise, and the same read as if nobody had framed them.
    let framed = self::share(&read(&mut reader, &far.marked).0, &message);
    let whole = ExtractorWeights { known_views: None, ..embedded.extractor };
    let mut whole = Reader::new(&gpu, &clip, key, &whole).expect("belongs to the key");
    let unframed = self::share(&read(&mut whole, &far.marked).0, &message);
    println!("{mode:?}: {framed} of the bits of far films, {unframed} without framing");
    assert!(framed >= FAR_BITS_RIGHT, "{framed} of the bits of far films; at least {FAR_BITS_RIGHT} are due");
    assert!(framed >= unframed + FRAMING_GAIN, "{framed} of the bits framed, {unframed} whole");

    // The extractor that frames nothing reads them beside the original, whose cameras frame them.
    let (marked, _) = compare(&gpu, &mut whole, &model, &far.marked, FAR);
    let (_, all_clean) = compare(&gpu, &mut whole, &model, &far.clean, FAR);
    let (beside, clean) = (self::share(&marked, &message), all_clean.matches(&message).expect("16 bits"));
    println!("{mode:?}: {beside} of the bits of far films beside the original, {clean} of {BITS} without a mark");
    assert!(beside >= unframed + FRAMING_GAIN, "{beside} of the bits beside the original, {unframed} whole");
    assert!(beside >= FAR_BITS_RIGHT, "{beside} of the bits of far films; at least {FAR_BITS_RIGHT} are due");
    assert!(band.contains(&clean), "{clean} of {BITS} bits; {band:?} is what chance leaves");
}

#[test]
fn a_blind_mark_is_read_from_h264_films_of_unseen_cameras() {
    assert_read(ExtractorMode::Blind);
}

#[test]
fn a_mark_for_the_pretrained_extractor_is_read_from_h264_films_of_unseen_cameras() {
    assert_read(ExtractorMode::Pretrained);
}
