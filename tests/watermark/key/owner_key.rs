//! Keys: that they follow from their secret, read what they never saw, and are refused when changed.

use std::path::Path;
use std::sync::OnceLock;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::base::tensor_file::{Tensor, TensorFile, Values};
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::watermark::key::capacity::{HeldOutReading, Spectrum, check_reading, check_spectrum};
use guard4d_engine::watermark::key::decoder::Decoder;
use guard4d_engine::watermark::key::owner_key::{Key, KeyReport};

use crate::support::gpu::{Gpu, device};
use crate::support::owner::sealed;
use crate::support::random::Random;
use crate::support::tiny_clip;

/// Bits of the keys made here; all messages of so few are seen in training.
const BITS: u32 = 8;
/// The secret of the key that tests share.
pub(crate) const SECRET: [u8; 32] = [3; 32];

fn generate(gpu: &Gpu, clip: &ClipModel, secret: [u8; 32]) -> (Key, KeyReport) {
    Key::generate(gpu, clip, MasterSecret::from_bytes(secret), BITS).expect("the tiny checkpoint carries eight bits")
}

/// The key of [`SECRET`] for the tiny checkpoint, made once per process.
pub(crate) fn shared(gpu: &Gpu) -> &'static (Key, KeyReport) {
    static KEY: OnceLock<(Key, KeyReport)> = OnceLock::new();
    KEY.get_or_init(|| generate(gpu, &tiny_clip::load(gpu, &tiny_clip::weights()), SECRET))
}

/// Share of the bits of random messages that a key reads from their text features.
pub(crate) fn accuracy(gpu: &Gpu, clip: &ClipModel, key: &Key, seed: u64) -> f64 {
    const MESSAGES: usize = 64;
    let mut random = Random(seed);
    let draw = |_| Message::from_bits(&(0..key.bits()).map(|_| random.below(2) == 1).collect::<Vec<_>>());
    let messages: Vec<Message> = (0..MESSAGES).map(draw).collect::<Result<_, _>>().expect("a length of messages");
    let ids: Vec<u32> = messages.iter().flat_map(|m| key.table.sequence(m).expect("the key's length")).collect();
    let features = clip.text().expect("loads").embed(&ids, key.bits() + 2).expect("embeds").features;
    let decoder = Decoder::new(gpu, &key.decoder).expect("fits");
    let mut pass = decoder.pass(gpu, MESSAGES).expect("fits");
    let input = gpu.buffer_from("features", &features).expect("fits");
    let mut rec = gpu.recorder().expect("records");
    decoder.forward(&mut rec, &input, &mut pass).expect("shapes fit");
    rec.submit().expect("runs");
    let logits = pass.logits.read().expect("readable");
    let bits = messages.iter().flat_map(Message::bits);
    let right = logits.iter().zip(bits).filter(|(logit, bit)| (**logit > 0.0) == *bit).count();
    right as f64 / logits.len() as f64
}

#[test]
fn a_key_reads_what_its_text_tower_writes() {
    let Some(gpu) = device() else { return };
    let clip = tiny_clip::load(&gpu, &tiny_clip::weights());
    let (key, report) = shared(&gpu);
    assert_eq!((report.held_out_accuracy, report.held_out_exact), (1.0, 1.0), "the report's own messages");
    assert_eq!(accuracy(&gpu, &clip, key, 5), 1.0, "messages of ours");
    assert_eq!((report.bits, key.bits()), (8, 8));
    let random = Payload::parse("random", 8).and_then(|payload| payload.message(&key.prf())).expect("8 bits");
    assert_eq!(key.own_message(), random, "what `random` stands for");
    assert_eq!(report.key_id, key.prf().key_id().to_string());
    let spectrum = &report.spectrum.0;
    assert!(spectrum.is_sorted_by(|a, b| a >= b) && spectrum[7] > 0.002 && spectrum.len() == 64, "{spectrum:?}");
}

#[test]
fn another_secret_is_another_key() {
    let Some(gpu) = device() else { return };
    let clip = tiny_clip::load(&gpu, &tiny_clip::weights());
    let (key, _) = shared(&gpu);
    let (other, report) = generate(&gpu, &clip, [4; 32]);
    assert_eq!(report.held_out_accuracy, 1.0, "as good a key");
    assert_ne!(key.prf().key_id(), other.prf().key_id());
    assert_ne!(key.table, other.table, "token table");
    for (layer, (a, b)) in key.decoder.layers.iter().zip(&other.decoder.layers).enumerate() {
        assert!(a.weight != b.weight && a.bias != b.bias, "layer {layer} of the decoder");
    }
    assert!(key.codes != other.codes && key.text_mean != other.text_mean, "training messages");
    assert_ne!(key.decoder_digest(), other.decoder_digest());
    // Of eight bits two keys share a message once in 256; 48 bits tell them apart.
    let message = |key: &Key| Payload::Random(48).message(&key.prf()).expect("48 bits");
    assert_ne!(message(key), message(&other));
}

/// What a key file holds beside its secret and what was trained is measured again, on whatever device.
#[test]
fn keys_follow_from_their_secret_and_those_that_do_not_are_refused() {
    let Some(gpu) = device() else { return };
    let clip = tiny_clip::load(&gpu, &tiny_clip::weights());
    let (key, _) = shared(&gpu);
    key.check(&gpu, &clip).expect("our own key");
    let again = Key::untrained(&clip, MasterSecret::from_bytes(SECRET), BITS).expect("derives");
    assert_eq!(again.text_codes().deviation(&key.text_codes()), 0.0, "the same on the same device");
    let refused = |change: &dyn Fn(&mut Key)| {
        let mut changed = key.clone();
        change(&mut changed);
        let error = changed.check(&gpu, &clip).expect_err("it does not follow");
        assert_eq!(error.exit_code(), 65, "{error}");
        error.to_string()
    };
    for nudge in [1e-3, f32::NAN, f32::INFINITY] {
        assert!(refused(&|key| key.codes.iter_mut().for_each(|c| *c *= 1.0 + nudge)).contains("text_mean or codes"));
        assert!(refused(&|key| key.text_mean[3] += nudge).contains("text_mean or codes"), "by {nudge}");
    }
    // One bit that is always read as 1, and a decoder of zeros.
    let said = refused(&|key| key.decoder.layers[2].bias[5] += 1e4);
    assert!(said.contains("decoder") && said.contains("bit 5 right in 50 %"), "{said}");
    assert!(refused(&|key| key.decoder.layers[2].weight.fill(0.0)).contains("decoder"), "it reads nothing");
}

#[test]
fn each_asset_has_a_key_of_its_own_that_tells_nothing_of_others() {
    let Some(gpu) = device() else { return };
    let clip = tiny_clip::load(&gpu, &tiny_clip::weights());
    let (owner, _) = shared(&gpu);
    let [one, other] = [b"one", b"two"].map(|asset| owner.for_asset(Digest::of(asset)).expect("an owner's key"));
    let ids = [owner, &one, &other].map(|key| key.prf().key_id().to_string());
    assert!(ids[0] != ids[1] && ids[1] != ids[2] && ids[0] != ids[2], "{ids:?}");
    assert_eq!((&one.table, &one.decoder, &one.codes), (&other.table, &other.decoder, &other.codes), "what is trained");
    assert_eq!((one.public_key(), one.asset()), (owner.public_key(), Some(Digest::of(b"one"))));
    assert_eq!(one.for_asset(Digest::of(b"one")).expect("its own").prf().key_id(), one.prf().key_id());
    assert!(one.for_asset(Digest::of(b"two")).is_err(), "an asset's key opens no other asset");

    // As it is disclosed: it reads the same, and neither signs nor holds the owner's secret.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("asset.key");
    one.write(&path, Existing::Refuse).expect("writable");
    let read = Key::read(&path, &clip).expect("our own key");
    assert_eq!((read.prf().key_id(), read.own_message()), (one.prf().key_id(), one.own_message()));
    assert_eq!((read.public_key(), read.asset()), (one.public_key(), one.asset()));
    assert!(read.signing_key().is_none() && read.for_asset(Digest::of(b"two")).is_err(), "nothing else");
    read.check(&gpu, &clip).expect("it follows from what is disclosed");
    let bytes = std::fs::read(&path).expect("written above");
    let hex: Vec<u8> = SECRET.iter().flat_map(|byte| format!("{byte:02x}").into_bytes()).collect();
    assert!(!bytes.windows(hex.len()).any(|window| window == hex), "no master secret");
    let shown = format!("{owner:?} {one:?} {read:?}");
    assert!(shown.contains("hidden") && !shown.contains(std::str::from_utf8(&hex).expect("digits")), "{shown}");
}

/// Field, found and expected of the refusal of a key file.
fn refusal(folder: &Path, file: &TensorFile, clip: &ClipModel) -> [String; 3] {
    let path = folder.join("changed.key");
    std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
    match Key::read(&path, clip) {
        Err(EngineError::BadData { path: named, field, got, expected }) => {
            assert_eq!(named, path, "the file is named");
            [field, got, expected]
        }
        other => panic!("must be refused as bad data: {other:?}"),
    }
}

#[test]
fn changed_and_foreign_keys_are_refused() {
    let Some(gpu) = device() else { return };
    let clip = tiny_clip::load(&gpu, &tiny_clip::weights());
    let (key, _) = shared(&gpu);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("owner.key");
    key.write(&path, Existing::Refuse).expect("writable");
    let read = Key::read(&path, &clip).expect("our own key");
    assert_eq!((&read.table, &read.decoder, read.decoder_digest()), (&key.table, &key.decoder, key.decoder_digest()));
    let good = TensorFile::read(&path).expect("a key file");
    let refused = |file: &TensorFile| refusal(folder.path(), file, &clip);
    let with_tensor = |name: &str, change: &dyn Fn(&mut Tensor)| {
        let mut file = good.clone();
        change(file.tensors.get_mut(name).expect("a tensor of keys"));
        file
    };

    let swapped = |tensor: &mut Tensor| match &mut tensor.values {
        Values::U32(ids) => ids.swap(0, 1),
        other => panic!("token ids are integers: {other:?}"),
    };
    let table = with_tensor("token_table", &swapped);
    let want = ["token_table", "a table that does not follow from the secret", "the derived table"];
    assert_eq!(refused(&table), want);
    assert_eq!(refused(&sealed(table)), want, "also if it is sealed anew");

    let nudged = |tensor: &mut Tensor| match &mut tensor.values {
        Values::F32(weights) => weights[7] += 1e-6,
        other => panic!("weights are floats: {other:?}"),
    };
    for name in ["decoder.0.weight", "decoder.2.bias", "codes", "text_mean"] {
        let [field, got, expected] = refused(&with_tensor(name, &nudged));
        assert_eq!(field, "content", "{name}");
        assert!(got.len() == 64 && expected.contains("the key was changed"), "{name}: {got}, {expected}");
    }
    let cut = |tensor: &mut Tensor| *tensor = Tensor::f32(&[8, 255], vec![0.0; 8 * 255]);
    let [field, got, expected] = refused(&with_tensor("decoder.2.weight", &cut));
    assert_eq!(field, "decoder.2.weight");
    assert!(got.contains("[8, 255]") && expected.contains("[8, 256]"), "{got}, {expected}");

    let mut stolen = good.clone();
    stolen.meta.insert("secret".to_owned(), "04".repeat(32));
    assert_eq!(refused(&sealed(stolen))[0], "token_table", "a table and a decoder under another secret");
    let mut unsealed = good.clone();
    unsealed.meta.remove("content");
    assert_eq!(refused(&unsealed)[0], "metadata `content`");

    let mut weights = tiny_clip::weights();
    weights.tensors.insert("logit_scale".to_owned(), Tensor::f32(&[], vec![4.0]));
    let [field, got, expected] = refusal(folder.path(), &good, &tiny_clip::load(&gpu, &weights));
    assert_eq!(field, "clip");
    assert!(got.contains(&key.clip.to_string()) && expected.starts_with("one made with checkpoint"), "{expected}");
}

/// What a checkpoint that cannot carry eight bits is refused with.
fn no_key(gpu: &Gpu, weights: &TensorFile) -> String {
    let clip = tiny_clip::load(gpu, weights);
    let made = Key::generate(gpu, &clip, MasterSecret::from_bytes(SECRET), BITS);
    let error = made.expect_err("it cannot carry a message");
    assert_eq!(error.exit_code(), 65, "{error}");
    error.to_string()
}

#[test]
fn checkpoints_that_cannot_carry_a_message_make_no_key() {
    let Some(gpu) = device() else { return };
    let mut silent = tiny_clip::weights();
    let tokens = silent.get(tiny_clip::TOKENS).expect("a tensor").shape.clone();
    silent.tensors.insert(tiny_clip::TOKENS.to_owned(), Tensor::f32(&tokens, vec![0.0; tokens.iter().product()]));
    let said = no_key(&gpu, &silent);
    assert!(said.contains("singular value 8") && said.contains("cannot carry 8 bits"), "{said}");
    // Every feature is 0/0 or 0.
    let zeros = |(name, tensor): (&String, &Tensor)| {
        (name.clone(), Tensor::f32(&tensor.shape, vec![0.0; tensor.shape.iter().product()]))
    };
    let dead = TensorFile { tensors: silent.tensors.iter().map(zeros).collect(), ..TensorFile::default() };
    let said = no_key(&gpu, &dead);
    assert!(said.contains("cannot carry"), "{said}");
}

#[test]
fn spectra_and_readings_below_the_bar_are_refused() {
    let clip = Path::new("clip");
    let spectrum = |weakest: f32| check_spectrum(&Spectrum(vec![1.0, 0.5, weakest]), 3, clip);
    assert!(spectrum(0.002).is_ok(), "at the bar");
    for weakest in [0.0019, 0.0, f32::NAN] {
        let error = spectrum(weakest).expect_err("too weak").to_string();
        assert!(error.contains("clip") && error.contains("singular value 3") && error.contains("3 bits"), "{error}");
    }
    assert!(check_spectrum(&Spectrum(vec![1.0; 2]), 3, clip).is_err(), "fewer directions than bits");
    let reading = |bit_accuracy, bits| check_reading(&HeldOutReading { bit_accuracy, exact: 1.0 }, bits, clip);
    for (accuracy, bits) in [(1.0, 16), (1.0, 32), (0.9999, 48), (1.0, 48)] {
        assert!(reading(accuracy, bits).is_ok(), "{accuracy} of {bits} bits");
    }
    for (accuracy, bits) in [(0.999_99, 16), (0.999_99, 32), (0.999_89, 48), (f64::NAN, 16), (f64::NAN, 48)] {
        let error = reading(accuracy, bits).expect_err("a bit is misread").to_string();
        assert!(error.contains("held-out") && error.contains(&format!("cannot carry {bits} bits")), "{error}");
    }
}
