//! The controls of `guard4d verify`: quiet where nothing is marked, and in the way of "present" where something is.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use guard4d_engine::base::output::Existing;
use guard4d_engine::base::tensor_file::Tensor;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::evidence::thresholds::Thresholds;
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::delivery::{EXTRACTOR, RECEIPT};
use guard4d_engine::release::receipt::{Anchor, Promise, Receipt, ReceiptBody};
use guard4d_engine::scene::Model;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::watermark::embed::{EmbedConfig, Profile};
use guard4d_engine::watermark::extractor::calibration::Calibration;
use guard4d_engine::watermark::extractor::reader::{self, Reader};
use guard4d_engine::watermark::extractor::rotation::KeyRotation;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::Key;
use serde_json::Value;
use tempfile::TempDir;

use super::{Run, guard4d, put, scratch};
use crate::release::receipt::body;
use crate::support::gpu::{Gpu, device};
use crate::support::owner::{demo_content, key_file, key_file_of, key_of, sealed};
use crate::support::random::Random;

/// Shortest messages that a control can contradict: 16 of 16 matches are 1.5e-5 by chance.
const BITS: u32 = 16;
/// The suspect clip, and what an original is rendered like: enough frames for a verdict.
const VIEWS: [&str; 6] = ["--orbit", "1", "--frames", "8", "--size", "64x64"];
/// How far the suspect clip's logits are from zero.
pub(super) const MARGIN: f32 = 0.01;

/// A suspect clip: how large its frames are, and how far its logits are from zero.
#[derive(Clone, Copy)]
pub(super) struct Film {
    pub(super) margin: f32,
    pub(super) size: &'static str,
}

/// An owner whose extractor reads the key's own message from one rendered clip.
///
/// No training makes it so: the zero of every bit is laid beside that clip's logit. Any other clip reads as it falls.
pub(super) struct Rigged {
    folder: TempDir,
    original: DemoScene,
}

impl Rigged {
    pub(super) fn get(gpu: &Gpu) -> &'static Self {
        static RIGGED: OnceLock<Rigged> = OnceLock::new();
        RIGGED.get_or_init(|| Self::new(gpu, "random", BITS))
    }

    /// Of a key of `bits` bits, saying `message` as the command line names it.
    pub(super) fn new(gpu: &Gpu, message: &str, bits: u32) -> Self {
        Self::filmed(gpu, message, bits, Film { margin: MARGIN, size: "64x64" })
    }

    /// The same with another suspect clip.
    pub(super) fn filmed(gpu: &Gpu, message: &str, bits: u32, film: Film) -> Self {
        let rigged = Self { folder: scratch(), original: DemoScene::unpack().expect("the scene unpacks") };
        let clip = ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
        let owner = key_of(&clip, [7; 32], bits);
        owner.write(&rigged.file("owner.key"), Existing::Refuse).expect("writable");
        let model = Model::open(rigged.original.path()).expect("the scene opens");
        let key = owner.for_asset(model.digest()).expect("an owner's key");
        let marked: Vec<f32> = model.gaussians.sh_coeffs.iter().map(|h| 1.5 * h).collect();
        model.write_marked(&rigged.file("marked"), &marked).expect("writable");
        let suspect = rigged.file("suspect");
        let render: [&dyn AsRef<OsStr>; 4] = [&"render", &rigged.file("marked"), &"--out", &suspect];
        let size: [&dyn AsRef<OsStr>; 2] = [&"--size", &film.size];
        guard4d(&[&render[..], &views()[..4], &size].concat()).done();
        let frames = read_clip(&suspect, &ReadOptions::default()).expect("our own frames");
        let payload = Payload::parse(message, bits).expect("a message");
        let message = payload.message(&key.prf()).expect("a length");
        let extractor = rig(gpu, (&clip, &key), frames.frames(), &message, film.margin);
        fs::create_dir(rigged.file("private")).expect("writable");
        extractor.write(&rigged.file("private").join(EXTRACTOR), &key, Existing::Refuse).expect("writable");
        let promise = Promise { payload: payload.id_bits(), ..promise(&key, &message, &extractor) };
        let signer = key.signing_key().expect("an owner's key");
        let settings = serde_json::json!({ "config": small_config(&key, &model).to_json() });
        let receipt = Receipt::seal(ReceiptBody { promise, settings, ..body() }, &signer).expect("finite figures");
        receipt.write(&rigged.file("private").join(RECEIPT)).expect("writable");
        rigged
    }

    pub(super) fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(super) fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    /// Reads the suspect clip with `key`, and the controls that `more` names.
    pub(super) fn verify_with(&self, key: &Path, more: &[&dyn AsRef<OsStr>]) -> Run {
        self.verify_film(&self.file("suspect"), key, more)
    }

    /// Reads any film with `key`.
    pub(super) fn verify_film(&self, film: &Path, key: &Path, more: &[&dyn AsRef<OsStr>]) -> Run {
        let receipt = self.file("private").join(RECEIPT);
        let args: [&dyn AsRef<OsStr>; 6] = [&"verify", &film, &"--key", &key, &"--receipt", &receipt];
        guard4d(&[&args[..], more].concat())
    }

    /// The suspect clip with the owner's key, as JSON.
    #[track_caller]
    pub(super) fn verify(&self, code: i32, more: &[&dyn AsRef<OsStr>]) -> Value {
        self.judge(&self.file("suspect"), code, more)
    }

    /// Any film with the owner's key, as JSON.
    #[track_caller]
    pub(super) fn judge(&self, film: &Path, code: i32, more: &[&dyn AsRef<OsStr>]) -> Value {
        let run = self.verify_film(film, &self.file("owner.key"), &[more, &[&"--json"]].concat());
        assert_eq!(run.code, code, "{}{}", run.stdout, run.stderr);
        serde_json::from_str(&run.stdout).expect("JSON on stdout")
    }
}

/// Settings of an embedding that is over in a moment.
pub(super) fn small_config(key: &Key, model: &Model) -> EmbedConfig {
    EmbedConfig::new(Profile::Draft, ExtractorMode::Blind).with(|config| {
        config.views.clips = 2;
        config.views.size_px = (32, 32);
        config.views = config.views.clone().looking_at(config.views.look_at(model));
        config.extractor.calibration_mut().expect("fitted").probes = 2 * key.bits();
    })
}

/// What a receipt promises of an extractor that reads `message`.
pub(super) fn promise(key: &Key, message: &Message, extractor: &ExtractorWeights) -> Promise {
    Promise {
        key_id: key.prf().key_id(),
        num_bits: message.num_bits(),
        message_mac: message.commitment(&key.prf()),
        payload: None,
        token_table: key.table.digest(),
        decoder: key.decoder_digest(),
        extractor_mode: extractor.mode,
        extractor: Some(extractor.digest(key).expect("shapes fit")),
        clip: key.clip,
        preprocess: extractor.preprocess(),
        thresholds: Thresholds::for_bits(key.bits()),
        owner_chips: None,
        anchor: key.asset().map(|asset| Anchor {
            asset,
            scene: demo_content(),
            reader: reader::digest(key, extractor).expect("shapes fit"),
            signer: key.public_key(),
        }),
    }
}

fn key_bytes(clip: &ClipModel, secret: [u8; 32]) -> Vec<u8> {
    key_file_of(clip, secret, BITS).to_bytes().expect("serialises")
}

pub(super) fn views() -> [&'static dyn AsRef<OsStr>; 6] {
    VIEWS.each_ref().map(|word| word as &dyn AsRef<OsStr>)
}

/// Random directions, and zeros that make `frames` say `message` by a margin.
pub(super) fn rig(
    gpu: &Gpu,
    (clip, key): (&ClipModel, &Key),
    frames: &[Frame],
    message: &Message,
    margin: f32,
) -> ExtractorWeights {
    let width = key.text_mean.len();
    let mut extractor = ExtractorWeights {
        mode: ExtractorMode::Blind,
        tmsd: None,
        calibration: Calibration {
            mean_image: vec![0.0; width],
            // Features have unit length and differ by a few hundredths; bits are to differ by about 1.
            directions: Random(32).vec_f32(width * key.bits(), -6.0, 6.0),
            mean_logits: vec![0.0; key.bits()],
        },
        key_rotation: KeyRotation::FIXED,
        known_views: None,
        content: None,
    };
    let logits = Reader::new(gpu, clip, key, &extractor).and_then(|mut r| r.logits(frames)).expect("reads");
    for (bit, (zero, wanted)) in extractor.calibration.mean_logits.iter_mut().zip(message.bits()).enumerate() {
        let sum: f32 = logits.iter().skip(bit).step_by(key.bits()).sum();
        *zero = sum / frames.len() as f32 - if wanted { margin } else { -margin };
    }
    extractor
}

/// What the panel says of a pool of controls, and why the verdict is what it is.
fn pool_and_reasons(report: &Value, pool: &str) -> (String, String) {
    let pools = report["evidence"]["panel"]["pools"].as_array().expect("a list");
    let found = pools.iter().find(|k| k["pool"] == pool).unwrap_or_else(|| panic!("{pool} is not in {pools:?}"));
    (found["state"].as_str().expect("a word").to_owned(), report["evidence"]["reasons"].to_string())
}

#[test]
fn without_controls_the_report_says_which_were_not_run() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let report = rigged.verify(0, &[]);
    let panel = &report["evidence"]["panel"];
    assert_eq!(panel["not_run"], serde_json::json!(["clean_render", "unrelated_clip", "other_key"]), "{panel}");
    for others in ["other_messages", "other_readings"] {
        assert_eq!((&panel[others]["num_keys"], &panel[others]["state"]), (&1000.into(), &"quiet".into()), "{panel}");
    }
    let run = rigged.verify_with(&rigged.file("owner.key"), &[]);
    for words in ["PRESENT", "16 of 16 match (8 frames)", "arithmetic: other messages", "the only claim", "free part"] {
        assert!(run.stdout.contains(words), "`{words}` is not in:\n{}", run.stdout);
    }
    assert!(run.stdout.contains("clean render, unrelated clip, other key"), "{}", run.stdout);
}

/// The rigged extractor is none that any original gives.
#[test]
fn an_extractor_that_does_not_follow_from_the_original_is_refused() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let owner = rigged.file("owner.key");
    let refused = |model: &Path, code: i32, words: &[&str]| {
        let original: [&dyn AsRef<OsStr>; 2] = [&"--original", &model];
        rigged.verify_with(&owner, &[&original[..], &views()[..]].concat()).refused(code, words);
    };
    let words = ["extractor.safetensors: tmsd.colour_map", "away from what the original gives"];
    refused(rigged.original.path(), 65, &words);
    refused(&rigged.file("marked"), 65, &["receipt.json: asset", "the hash of the original given"]);
    refused(&rigged.file("nowhere"), 66, &["nowhere: not found", "a 4DGaussians folder"]);
}

#[test]
fn an_unrelated_clip_is_quiet_unless_it_says_the_message() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let folder = scratch();
    let plain = folder.path().join("plain");
    let grey = Frame::new(64, 64, vec![90; 3 * 64 * 64]).expect("the length fits");
    write_png_folder(&plain, &[(); 8].map(|()| grey.clone())).expect("writable");
    let suspect = rigged.file("suspect");
    let (state, reasons) = pool_and_reasons(&rigged.verify(0, &[&"--unrelated", &plain]), "unmarked_films");
    assert!(state == "quiet" && reasons.contains("passes"), "{state}, {reasons}");
    let both: [&dyn AsRef<OsStr>; 4] = [&"--unrelated", &plain, &"--unrelated", &suspect];
    let (_, reasons) = pool_and_reasons(&rigged.verify(4, &both), "unmarked_films");
    assert!(reasons.contains("control_fires") && reasons.contains("unrelated clip"), "{reasons}");
    // The same pixels in files of another content.
    let repacked = folder.path().join("repacked");
    fs::create_dir(&repacked).expect("writable");
    for number in 0..8 {
        let pixels = image::RgbaImage::from_pixel(64, 64, image::Rgba([90, 90, 90, 255]));
        pixels.save(repacked.join(format!("{number}.png"))).expect("writable");
    }
    let again: [&dyn AsRef<OsStr>; 6] = [&"--unrelated", &plain, &"--unrelated", &plain, &"--unrelated", &repacked];
    let panel = &rigged.verify(0, &again)["evidence"]["panel"];
    assert_eq!(panel["pools"][0]["num_readings"], 7, "the program's own six, and one film however often: {panel}");
}

/// Whoever tried the film with others has to say so, and the report says it on.
#[test]
fn claims_multiply_the_p_value_and_what_was_chosen_by_hand_is_printed() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let p = |report: &Value| report["evidence"]["p_value"]["soft_score"].as_f64().expect("a p-value");
    let one = rigged.verify(0, &[]);
    let ten = rigged.verify(0, &[&"--claims", &"10"]);
    let tolerance = 1e-12;
    assert!((p(&ten) / p(&one) / 10.0 - 1.0).abs() < tolerance, "{} of one, {} of ten", p(&one), p(&ten));
    assert_eq!(ten["choices"]["claims"], 10, "{}", ten["choices"]);
    // 16 bits can do no better than 1.5e-5, and 100 of these miss 1e-3.
    let many = rigged.verify(4, &[&"--claims", &"100"]);
    assert_eq!(many["evidence"]["verdict"], "inconclusive");
    let more: [&dyn AsRef<OsStr>; 8] = [&"--claims", &"3", &"--start", &"1", &"--every", &"2", &"--max-frames", &"3"];
    let run = rigged.verify_with(&rigged.file("owner.key"), &more);
    let words = ["one of 2 frames from frame 1 on", "at most 3 frames of each film", "counted as one of 3 claims"];
    for words in words {
        assert!(run.stdout.contains(words), "`{words}` is not in:\n{}", run.stdout);
    }
    let region: [&dyn AsRef<OsStr>; 4] = [&"--crop", &"0,0,60,62", &"--picture-size", &"64x64"];
    let run = rigged.verify_with(&rigged.file("owner.key"), &region);
    for words in ["the part of 60 x 62 px at (0, 0)", "pictures brought to 64 x 64 px"] {
        assert!(run.stdout.contains(words), "`{words}` is not in:\n{}", run.stdout);
    }
    let run = rigged.verify_film(&rigged.file("marked"), &rigged.file("owner.key"), &views());
    assert!(run.stdout.contains("the cameras that film a model"), "{}", run.stdout);
}

#[test]
fn another_key_is_a_control_if_it_is_another_and_as_long() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let folder = scratch();
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let owner = rigged.file("owner.key");
    let other = put(folder.path(), "other.key", &key_bytes(&clip, [9; 32]));
    let (state, reasons) = pool_and_reasons(&rigged.verify(0, &[&"--other-key", &other]), "other_keys");
    assert!(state == "quiet" && reasons.contains("passes"), "{state}, {reasons}");
    let short = put(folder.path(), "short.key", &key_file(&clip).to_bytes().expect("serialises"));
    let refused = |key: &Path, words: &[&str]| rigged.verify_with(&owner, &[&"--other-key", &key]).refused(2, words);
    refused(&short, &["short.key: 8 bits", "16 bits like the owner's"]);
    refused(&owner, &["owner.key: the owner's key", "no part in the embedding"]);
}

#[test]
fn the_key_must_be_the_one_that_was_committed_to() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::get(&gpu);
    let folder = scratch();
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let refused = |name: &str, bytes: &[u8], words: &[&str]| {
        rigged.verify_with(&put(folder.path(), name, bytes), &[]).refused(65, words);
    };
    let words = ["receipt.json: key_id", "the key given"];
    refused("other.key", &key_bytes(&clip, [9; 32]), &words);
    let mut file = key_file_of(&clip, [7; 32], BITS);
    let bias = file.tensors.get_mut("decoder.2.bias").expect("a tensor of keys");
    *bias = Tensor::f32(&[BITS as usize], vec![0.25; BITS as usize]);
    refused(
        "retrained.key",
        &sealed(file).to_bytes().expect("serialises"),
        &["receipt.json: decoder", "the key given"],
    );
    let mut file = key_file_of(&clip, [7; 32], BITS);
    file.meta.insert("clip".to_owned(), "0".repeat(64));
    let words = ["foreign.key: clip", "a key made with checkpoint 0000", "one made with checkpoint"];
    refused("foreign.key", &sealed(file).to_bytes().expect("serialises"), &words);
}
