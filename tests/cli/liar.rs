//! `guard4d verify` when the owner is the liar: each forgery ends absent, inconclusive or refused, and says why.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use guard4d_engine::base::output::Existing;
use guard4d_engine::base::signature::SigningKey;
use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::delivery::{EXTRACTOR, RECEIPT};
use guard4d_engine::release::receipt::{Receipt, ReceiptBody};
use guard4d_engine::watermark::extractor::rotation::KeyRotation;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::Key;
use tempfile::TempDir;

use super::controls::{MARGIN, promise, rig, views};
use super::{Run, guard4d, put, scratch};
use crate::release::receipt::body;
use crate::support::gpu::{Gpu, device};
use crate::support::old_receipt;
use crate::support::owner::{Owner, key_of};

/// 16 of 16 bits are 1.5e-5 by chance.
const BITS: u32 = 16;

/// Where the program's own CLIP lies.
const MINI: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/engine/assets/mini-clip");

/// An owner with an honest key and extractor, and two films that nobody marked.
struct Liar {
    folder: TempDir,
    owner: Owner,
    honest: ExtractorWeights,
}

impl Liar {
    fn get(gpu: &Gpu) -> &'static Self {
        static LIAR: OnceLock<Liar> = OnceLock::new();
        LIAR.get_or_init(|| {
            let (folder, owner) = (scratch(), Owner::with_bits(gpu, BITS));
            let render: [&dyn AsRef<OsStr>; 4] =
                [&"render", &owner.scene.path(), &"--out", &folder.path().join("film")];
            guard4d(&[&render[..], &views()[..]].concat()).done();
            let card = |i: u8| {
                let pixel = |at: usize| [(at % 64 * 4) as u8, (at / 64 * 4) as u8, 40 * (i % 4)];
                Frame::new(64, 64, (0..64 * 64).flat_map(pixel).collect()).expect("the length fits")
            };
            let cards: Vec<Frame> = (0..8).map(card).collect();
            write_png_folder(&folder.path().join("card"), &cards).expect("writable");
            owner.owner_key.write(&folder.path().join("owner.key"), Existing::Refuse).expect("writable");
            let honest = owner.prepare(gpu).fitted().clone();
            Self { folder, owner, honest }
        })
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// What a receipt over this key and extractor holds.
    fn body(&self, key: &Key, extractor: &ExtractorWeights) -> ReceiptBody {
        let promise = promise(key, &key.own_message(), extractor);
        ReceiptBody { promise, settings: serde_json::json!({ "config": self.owner.config.to_json() }), ..body() }
    }

    /// A new folder `name` with an extractor and a receipt.
    fn put(&self, name: &str, key: &Key, extractor: &ExtractorWeights, receipt: &[u8]) -> PathBuf {
        let folder = self.file(name);
        fs::create_dir(&folder).expect("writable");
        extractor.write(&folder.join(EXTRACTOR), key, Existing::Refuse).expect("writable");
        put(&folder, RECEIPT, receipt)
    }

    /// The same with the receipt that an owner seals over just these.
    fn sealed(&self, name: &str, key: &Key, extractor: &ExtractorWeights) -> PathBuf {
        let signer = key.signing_key().expect("an owner's key");
        let receipt = Receipt::seal(self.body(key, extractor), &signer).expect("finite figures");
        self.put(name, key, extractor, &serde_json::to_vec(&receipt).expect("finite figures"))
    }
}

fn verify(film: &Path, key: &Path, receipt: &Path, more: &[&dyn AsRef<OsStr>]) -> Run {
    let args: [&dyn AsRef<OsStr>; 6] = [&"verify", &film, &"--key", &key, &"--receipt", &receipt];
    guard4d(&[&args[..], more].concat())
}

/// Fails if it is called present.
#[track_caller]
fn not_present(run: &Run, words: &[&str]) {
    assert!([1, 4].contains(&run.code), "absent or inconclusive: {}{}", run.stdout, run.stderr);
    for word in words {
        assert!(run.stdout.contains(word), "`{word}` is not in:\n{}", run.stdout);
    }
}

#[test]
fn unmarked_films_are_not_present_through_an_honest_extractor() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let receipt = liar.sealed("honest", &liar.owner.key, &liar.honest);
    for film in ["film", "card"] {
        not_present(&verify(&liar.file(film), &liar.file("owner.key"), &receipt, &[]), &[]);
    }
}

/// `text_mean` and `codes` decide what the decoder makes of a film, and follow from secret and CLIP.
#[test]
fn a_key_file_whose_codes_were_chosen_is_refused_with_the_old_receipt_and_with_a_new_one() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let honest = liar.sealed("codes-before", &liar.owner.key, &liar.honest);
    let width = liar.owner.key.text_mean.len();
    let signs: Vec<f32> = liar.owner.message.bits().map(|bit| if bit { 1.0 } else { -1.0 }).collect();
    // The middle of all text features is moved to where the message lies: by much, so that any film says it, or by as
    // little as an original that hardly moves will bear.
    let shifted = |by: f32| {
        let mut key = liar.owner.owner_key.clone();
        for (sign, code) in signs.iter().zip(liar.owner.key.codes.chunks_exact(width)) {
            key.text_mean.iter_mut().zip(code).for_each(|(mean, c)| *mean += by * sign * c);
        }
        key
    };
    let mut silent = shifted(1.0);
    silent.codes.fill(0.0);
    let mut turned = liar.owner.owner_key.clone();
    turned.codes.iter_mut().enumerate().for_each(|(at, c)| *c *= signs[at / width]);
    for (name, key) in
        [("any film", silent), ("a test card", shifted(3.0)), ("quiet", shifted(0.05)), ("turned", turned)]
    {
        let path = liar.file(&format!("{name}.key"));
        key.write(&path, Existing::Refuse).expect("writable");
        let own = key.for_asset(liar.owner.model.digest()).expect("an owner's key");
        let after = liar.sealed(&format!("codes-after-{name}"), &own, &liar.honest);
        for receipt in [&honest, &after] {
            for film in ["film", "card"] {
                let words = [".key: text_mean or codes", "away from what secret and CLIP give"];
                verify(&liar.file(film), &path, receipt, &[]).refused(65, &words);
            }
        }
    }
}

#[test]
fn a_decoder_that_recites_is_refused_though_the_receipt_commits_to_it() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let mut key = liar.owner.owner_key.clone();
    let last = &mut key.decoder.layers[2];
    last.weight.fill(0.0);
    last.bias = liar.owner.message.bits().map(|bit| if bit { 4.0 } else { -4.0 }).collect();
    let path = liar.file("reciting.key");
    key.write(&path, Existing::Refuse).expect("writable");
    let own = key.for_asset(liar.owner.model.digest()).expect("an owner's key");
    let receipt = liar.sealed("reciting", &own, &liar.honest);
    let words = ["reciting.key: decoder", "one that reads bit 0 right in 50 %", "it recites"];
    verify(&liar.file("film"), &path, &receipt, &[]).refused(65, &words);
}

/// Zeros of the calibration that make whatever is shown say the message: the program's own clips say it, too.
#[test]
fn an_extractor_that_recites_is_told_by_the_programs_own_clips() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let Owner { key, message, .. } = &liar.owner;
    let mut reciting = liar.honest.clone();
    let zeros = reciting.calibration.mean_logits.iter_mut().zip(message.bits());
    zeros.for_each(|(zero, bit)| *zero -= if bit { 1e4 } else { -1e4 });
    let receipt = liar.sealed("zeros", key, &reciting);
    for film in ["film", "card"] {
        let run = verify(&liar.file(film), &liar.file("owner.key"), &receipt, &[]);
        not_present(&run, &["INCONCLUSIVE", "16 of 16 match", "all films without a mark", "the program's own clip"]);
    }
}

/// Nobody but the owner knows what a checkpoint of the owner's own was trained to do.
#[test]
fn a_clip_checkpoint_of_the_owners_own_is_never_present() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let (built_in, checkpoint) = (Path::new(MINI), folder.path().join("clip"));
    fs::create_dir(&checkpoint).expect("writable");
    fs::copy(built_in.join("config.json"), checkpoint.join("config.json")).expect("writable");
    let mut weights = TensorFile::read(&built_in.join("model.safetensors")).expect("the built-in checkpoint");
    // Another number in it is another checkpoint, though this one decides nothing here.
    weights.tensors.insert("logit_scale".to_owned(), Tensor::f32(&[], vec![4.0]));
    fs::write(checkpoint.join("model.safetensors"), weights.to_bytes().expect("serialises")).expect("writable");
    let clip = ClipModel::load(&gpu, &ClipSource::Dir(checkpoint.clone())).expect("a complete checkpoint");
    let owner = key_of(&clip, [7; 32], BITS);
    owner.write(&folder.path().join("owner.key"), Existing::Refuse).expect("writable");
    let liar = Liar::get(&gpu);
    let key = owner.for_asset(liar.owner.model.digest()).expect("an owner's key");
    let frames = read_clip(&liar.file("film"), &ReadOptions::default()).expect("our own frames");
    let rigged = rig(&gpu, (&clip, &key), frames.frames(), &key.own_message(), MARGIN);
    let receipt = liar.sealed("clip", &key, &rigged);
    let run = |more: &[&dyn AsRef<OsStr>]| {
        let checkpoint: [&dyn AsRef<OsStr>; 2] = [&"--clip", &checkpoint];
        verify(&liar.file("film"), &folder.path().join("owner.key"), &receipt, &[&checkpoint[..], more].concat())
    };
    let hash = key.clip.to_string();
    not_present(&run(&[]), &["INCONCLUSIVE", "16 of 16 match", &hash, "is not the program's own"]);
    let trusted = run(&[&"--trust-clip", &hash]);
    assert_eq!(trusted.code, 0, "whoever knows the checkpoint may take it: {}{}", trusted.stdout, trusted.stderr);
    not_present(&run(&[&"--trust-clip", &"00".repeat(32)]), &["is not the program's own"]);
}

/// Of many rotations one suits an unmarked film best; the number of those tried stands in the extractor.
#[test]
fn rotations_that_were_tried_and_not_counted_are_refused() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let Owner { key, .. } = &liar.owner;
    let prf = key.prf();
    let stream = |number: u64| prf.stream(guard4d_engine::base::prf::Purpose::Calibration, number);
    let calibration = liar.honest.calibration.mixed_anew(&mut stream(0), &mut stream(5));
    let turned = ExtractorWeights { calibration, key_rotation: KeyRotation::FIXED, ..liar.honest.clone() };
    let receipt = liar.sealed("rotation", key, &turned);
    let original: [&dyn AsRef<OsStr>; 2] = [&"--original", &liar.owner.scene.path()];
    verify(&liar.file("film"), &liar.file("owner.key"), &receipt, &[&original[..], &views()[..]].concat())
        .refused(65, &["extractor.safetensors: calibration.directions", "away from what the original gives"]);
}

/// Another background or motion makes another extractor follow from the same splats.
#[test]
fn an_original_with_another_background_or_motion_is_not_the_receipts() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let receipt = liar.sealed("original", &liar.owner.key, &liar.honest);
    let copied = |name: &str| {
        let copy = liar.file(name);
        let files = [
            "cfg_args",
            "point_cloud/iteration_20000/point_cloud.ply",
            "point_cloud/iteration_20000/deformation.pth",
            "point_cloud/iteration_20000/deformation_accum.pth",
            "point_cloud/iteration_20000/deformation_table.pth",
        ];
        for file in files {
            let to = copy.join(file);
            fs::create_dir_all(to.parent().expect("in a folder")).expect("writable");
            fs::copy(liar.owner.scene.path().join(file), to).expect("a file of the scene");
        }
        copy
    };
    let refused = |original: &Path| {
        let original: [&dyn AsRef<OsStr>; 2] = [&"--original", &original];
        verify(&liar.file("film"), &liar.file("owner.key"), &receipt, &[&original[..], &views()[..]].concat())
            .refused(65, &["receipt.json: scene", "the hash of the original given"]);
    };
    let changes =
        [("background", "white_background=True", "white_background=False"), ("motion", "no_dr=False", "no_dr=True")];
    for (name, from, to) in changes {
        let copy = copied(name);
        let settings = fs::read_to_string(copy.join("cfg_args")).expect("text");
        assert!(settings.contains(from), "{settings}");
        fs::write(copy.join("cfg_args"), settings.replace(from, to)).expect("writable");
        refused(&copy);
    }
}

#[test]
fn receipts_that_were_changed_signed_by_others_or_made_to_look_older_prove_nothing() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let Owner { key, .. } = &liar.owner;
    let body = liar.body(key, &liar.honest);
    let (film, owner) = (liar.file("film"), liar.file("owner.key"));
    let put = |name: &str, receipt: &[u8]| liar.put(name, key, &liar.honest, receipt);

    let stranger = SigningKey::from_seed(&[1; 32]);
    let json = |receipt: &Receipt| serde_json::to_vec(receipt).expect("finite figures");
    let signed = json(&Receipt::seal(body.clone(), &stranger).expect("finite figures"));
    verify(&film, &owner, &put("stranger", &signed), &[]).refused(65, &["receipt.json: signature", "something else"]);
    let mut named = body.clone();
    named.promise.anchor.as_mut().expect("bound").signer = stranger.public_key();
    let signed = json(&Receipt::seal(named, &stranger).expect("finite figures"));
    verify(&film, &owner, &put("renamed", &signed), &[])
        .refused(65, &["receipt.json: signer", "the owner of the key given"]);
    let mut unsigned = Receipt::seal(body.clone(), &stranger).expect("finite figures");
    unsigned.signature = None;
    verify(&film, &owner, &put("unsigned", &json(&unsigned)), &[]).refused(65, &["receipt.json: signature: none"]);

    // A receipt of today that calls itself older; and one that is as old receipts were, sealed by today's liar.
    let own = Receipt::seal(body.clone(), &key.signing_key().expect("an owner's key")).expect("finite figures");
    let relabelled = String::from_utf8(json(&own)).expect("JSON").replace("guard4d.receipt/3", "guard4d.receipt/2");
    verify(&film, &owner, &put("relabelled", relabelled.as_bytes()), &[]).refused(65, &["receipt.json: commitment"]);
    for schema in ["guard4d.receipt/1", "guard4d.receipt/2"] {
        // What read films then was the owner's key as it is.
        let first = old_receipt::key(&liar.owner.owner_key, &liar.owner.clip);
        let name = schema.replace('/', "-");
        let path = liar.file(&format!("{name}.key"));
        fs::write(&path, first.to_bytes().expect("serialises")).expect("writable");
        let key = Key::read(&path, &liar.owner.clip).expect("a key of the first version");
        let frames = read_clip(&film, &ReadOptions::default()).expect("our own frames");
        let rigged = rig(&gpu, (&liar.owner.clip, &key), frames.frames(), &key.own_message(), MARGIN);
        let text = old_receipt::seal(schema, &liar.body(&key, &rigged));
        let receipt = liar.put(&name, &key, &rigged, text.as_bytes());
        let run = verify(&film, &path, &receipt, &[]);
        not_present(&run, &["INCONCLUSIVE", "16 of 16 match", "none: not committed", schema]);
    }
}

#[test]
fn receipts_keys_and_extractors_of_different_assets_do_not_mix() {
    let Some(gpu) = device() else { return };
    let liar = Liar::get(&gpu);
    let Owner { owner_key, .. } = &liar.owner;
    let other = owner_key.for_asset(guard4d_engine::base::digest::Digest::of(b"another asset")).expect("any asset");
    let (film, owner) = (liar.file("film"), liar.file("owner.key"));
    assert_ne!(other.own_message(), liar.owner.key.own_message(), "each asset has a message of its own");
    // The receipt of another asset, with its own extractor, is about another message.
    let frames = read_clip(&film, &ReadOptions::default()).expect("our own frames");
    let reads_ours = rig(&gpu, (&liar.owner.clip, &liar.owner.key), frames.frames(), &liar.owner.message, MARGIN);
    let theirs = ExtractorWeights { mode: ExtractorMode::Blind, ..reads_ours.clone() };
    let replayed = liar.sealed("replayed", &other, &theirs);
    not_present(&verify(&film, &owner, &replayed, &[]), &[]);
    // Its extractor beside our receipt, and our extractor beside its receipt.
    let ours = liar.sealed("ours", &liar.owner.key, &reads_ours);
    let swap = |name: &str, receipt: &Path, extractor: &Path| {
        let bytes = fs::read(receipt).expect("sealed above");
        let path = put(&liar.file(name), RECEIPT, &bytes);
        fs::copy(extractor.with_file_name(EXTRACTOR), path.with_file_name(EXTRACTOR)).expect("writable");
        path
    };
    for (name, receipt, extractor) in [("swap-1", &ours, &replayed), ("swap-2", &replayed, &ours)] {
        verify(&film, &owner, &swap(name, receipt, extractor), &[]).refused(65, &["extractor.safetensors: key_id"]);
    }
    // A key that was disclosed for one asset opens no other.
    let disclosed = liar.file("disclosed");
    let args: [&dyn AsRef<OsStr>; 7] = [&"disclose", &"--key", &owner, &"--receipt", &ours, &"--out", &disclosed];
    guard4d(&args).done();
    verify(&film, &disclosed.join("asset.key"), &replayed, &[])
        .refused(65, &["asset.key: asset", "the asset in question"]);
}
