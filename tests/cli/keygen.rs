//! `guard4d keygen`: what it prints, what it writes, and which checkpoints it refuses.

use std::fs;
use std::path::Path;

use guard4d_engine::base::output::Existing;
use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::watermark::key::owner_key::Key;

use super::{guard4d, names, put, scratch};
use crate::support::gpu::device;
use crate::support::tiny_clip;
use crate::watermark::key::owner_key::{SECRET, accuracy, shared};

fn hex(secret: [u8; 32]) -> String {
    secret.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The built-in checkpoint and the length that `./x demo` uses. (A key of 16 bits is about half a minute's work, most
/// of this suite's longest test. Keys of 32 and 48 bits were measured once, with `guard4d keygen --bits L --secret FILE
/// --json`: benches/results/2026-11-21-lavapipe/keys.md.)
#[test]
fn sixteen_bits_are_all_read_with_the_built_in_checkpoint() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let secret = put(folder.path(), "secret.hex", format!("{}\n", hex([1; 32])).as_bytes());
    let out = folder.path().join("owner.key");
    let run = guard4d(&[&"keygen", &"--bits", &"16", &"--secret", &secret, &"--out", &out, &"--json"]);
    run.done();
    assert!(run.stderr.contains("keep it private") && !run.stderr.contains(&hex([1; 32])), "{}", run.stderr);
    let report: serde_json::Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    assert_eq!((&report["held_out_accuracy"], &report["held_out_exact"]), (&1.0.into(), &1.0.into()), "{report}");
    assert_eq!(report["bits"], 16);
    // Ten times the least that is accepted: this checkpoint was tuned for messages.
    assert!(report["spectrum"][15].as_f64().is_some_and(|value| value > 0.02), "{}", report["spectrum"][15]);
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let key = Key::read(&out, &clip).expect("our own key");
    assert_eq!(report["key_id"], key.prf().key_id().to_string());
    assert_eq!(accuracy(&gpu, &clip, &key, 9), 1.0, "messages of ours");
}

#[test]
fn a_key_is_kept_under_a_passphrase() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let (folder, clip) = (folder.path(), tiny_clip::write(folder.path(), &tiny_clip::weights()));
    let secret = put(folder, "secret.hex", hex(SECRET).as_bytes());
    let (words, key) = (put(folder, "passphrase", b"correct horse\n"), folder.join("owner.key"));
    let keygen: [&dyn AsRef<std::ffi::OsStr>; 9] =
        [&"keygen", &"--clip", &clip, &"--bits", &"8", &"--secret", &secret, &"--out", &key];
    let missing = folder.join("nowhere");
    guard4d(&[&keygen[..], &[&"--passphrase-file", &missing]].concat()).refused(66, &["nowhere", "a passphrase"]);
    guard4d(&[&keygen[..], &[&"--passphrase-file", &words]].concat()).done();
    assert!(fs::read(&key).expect("written").starts_with(b"age-encryption.org/v1"), "encrypted");
    let embed: [&dyn AsRef<std::ffi::OsStr>; 7] =
        [&"embed", &folder.join("no-model"), &"--clip", &clip, &"--out", &folder.join("out"), &"--key"];
    // A key that opens is followed by the next complaint.
    guard4d(&[&embed[..], &[&key]].concat()).refused(65, &["owner.key: age", "--passphrase-file"]);
    guard4d(&[&embed[..], &[&key, &"--passphrase-file", &words]].concat()).refused(66, &["no-model"]);
    let ours = folder.join("ours.key");
    shared(&gpu).0.write(&ours, Existing::Refuse).expect("writable");
    guard4d(&[&embed[..], &[&ours, &"--passphrase-file", &words]].concat()).refused(66, &["no-model"]);
}

#[test]
fn the_same_secret_gives_the_same_file() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let clip = tiny_clip::write(folder.path(), &tiny_clip::weights());
    let secret = put(folder.path(), "secret.hex", hex(SECRET).as_bytes());
    let (ours, made) = (folder.path().join("ours.key"), folder.path().join("made.key"));
    shared(&gpu).0.write(&ours, Existing::Refuse).expect("writable");
    let run = guard4d(&[&"keygen", &"--clip", &clip, &"--bits", &"8", &"--secret", &secret, &"--out", &made]);
    run.done();
    for word in ["key id", "spectrum", "(8th, the weakest needed)", "held-out messages", "100.000 % of bits"] {
        assert!(run.stdout.contains(word), "`{word}` is not in:\n{}", run.stdout);
    }
    let read = |path: &Path| fs::read(path).expect("written above");
    assert!(read(&ours) == read(&made), "byte for byte, from another process");
}

#[test]
fn checkpoints_that_cannot_carry_the_bits_are_refused() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("owner.key");
    let keygen = |weights: &TensorFile, bits: &str| {
        let clip = tiny_clip::write(folder.path(), weights);
        guard4d(&[&"keygen", &"--clip", &clip, &"--bits", &bits, &"--out", &out])
    };
    let mut silent = tiny_clip::weights();
    let tokens = silent.tensors.get_mut(tiny_clip::TOKENS).expect("a tensor of checkpoints");
    *tokens = Tensor::f32(&tokens.shape, vec![0.0; tokens.shape.iter().product()]);
    let words = ["model.safetensors: singular value 8 of the message features", "0.00000", "cannot carry 8 bits"];
    keygen(&silent, "8").refused(65, &words);
    for bits in ["0", "9", "16"] {
        let words =
            [&format!("length: {bits} bits"), "a multiple of 8, 1 to 10 bits with this CLIP (context 12 tokens"];
        keygen(&tiny_clip::weights(), bits).refused(2, &words);
    }
    assert_eq!(names(folder.path()), ["tiny-clip"], "no key and no partial key");
}

#[test]
fn secrets_that_are_none_are_refused() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("owner.key");
    let keygen = |secret: &Path| guard4d(&[&"keygen", &"--secret", &secret, &"--out", &out]);
    let short = put(folder.path(), "secret.hex", b"c0ffee");
    keygen(&short).refused(65, &["secret.hex: secret", "64 hex digits"]);
    put(folder.path(), "secret.hex", "xy".repeat(32).as_bytes());
    keygen(&short).refused(65, &["secret.hex: secret", "64 hex digits"]);
    keygen(&folder.path().join("none.hex")).refused(66, &["none.hex: not found", "a master secret"]);
    assert_eq!(names(folder.path()), ["secret.hex"], "no key and no partial key");
}
