//! `guard4d verify` for clips that carry a number: what is read, what it is worth, and what is refused.

use std::ffi::OsStr;

use guard4d_engine::evidence::id_code::IdBits;
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::delivery::RECEIPT;
use guard4d_engine::release::receipt::{Receipt, ReceiptBody};
use guard4d_engine::scene::ply;
use guard4d_engine::watermark::key::owner_key::Key;
use serde_json::{Value, json};

use super::controls::Rigged;
use super::{guard4d, put, scratch};
use crate::support::fixture::gaussians;
use crate::support::gpu::device;
use crate::support::owner::key_file_of;

/// Bits that are enough for an id to pass the rate that such short keys are asked for.
const BITS: u32 = 24;

#[test]
fn numbers_are_read_blindly_or_claimed() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::new(&gpu, "id:12:1234", BITS);
    let id_of = |report: &Value| (report["id"]["id"].clone(), report["id"]["is_promised"].clone());
    for more in [&[] as &[&dyn AsRef<OsStr>], &[&"--message", &"id:12"]] {
        let report = rigged.verify(0, more);
        assert_eq!(id_of(&report), (json!(1234), json!(true)), "{report}");
        let p = &report["evidence"]["p_value"];
        // All 24 bits match: 2^-24 for each of 2^12 ids.
        assert_eq!((&p["kind"], &p["matches"]), (&json!("searched"), &json!(0.5_f64.powi(12))), "{p}");
        assert_eq!(report["id"]["p_value"]["matches"], p["matches"], "{report}");
        assert!(report["id"]["margin"].as_f64().is_some_and(|margin| margin > 0.0), "{report}");
        assert_eq!((&report["clips"][0]["exact"], &report["clips"][0]["id"]), (&json!(true), &json!(1234)), "{report}");
    }
    let claimed = rigged.verify(0, &[&"--message", &"id:12:1234"]);
    let p = &claimed["evidence"]["p_value"];
    assert_eq!((&p["kind"], &p["matches"]), (&json!("exact"), &json!(0.5_f64.powi(24))), "{p}");
    assert_eq!(claimed["id"]["p_value"]["matches"], json!(0.5_f64.powi(12)), "the search has its own: {claimed}");
    let (owner, suspect) = (rigged.file("owner.key"), rigged.file("suspect"));
    let text = rigged.verify_with(&owner, &[&suspect]);
    for words in ["id of 12 bits", "1234, the one of the receipt", "the best of 4096", "24 of 24 match (16 frames)"] {
        assert!(text.stdout.contains(words), "`{words}` is not in:\n{}", text.stdout);
    }
    assert_eq!(text.stdout.matches("recovered exactly: yes, id 1234").count(), 2, "both clips:\n{}", text.stdout);
    for other in ["id:12:1235", "id:16", "id:16:1234", "random", "hex:000000"] {
        let words = ["receipt.json: message_mac", "another message"];
        rigged.verify_with(&owner, &[&"--message", &other]).refused(65, &words);
    }
    rigged.verify_with(&owner, &[&"--message", &"id:12:5000"]).refused(2, &["id 5000", "0 to 4095"]);
    let key = guard4d(&[&"inspect", &owner, &"--json"]);
    key.done();
    let key: Value = serde_json::from_str(&key.stdout).expect("JSON on stdout");
    let needed =
        json!({"claimed": {"1e-3": 20, "1e-6": 24, "1e-9": null}, "id:12": {"1e-3": 24, "1e-6": null, "1e-9": null}});
    assert_eq!(
        (&key["matches_needed"]["claimed"], &key["matches_needed"]["id:12"]),
        (&needed["claimed"], &needed["id:12"])
    );
}

#[test]
fn embedding_a_number_promises_its_kind() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let key = put(folder.path(), "owner.key", &key_file_of(&clip, [7; 32], BITS).to_bytes().expect("serialises"));
    let model = put(folder.path(), "model.ply", &ply::encode(&gaussians(60, 1, 3)));
    let out = folder.path().join("out");
    let embed = |message: &str| {
        let rest = "--steps 1 --train-clips 2 --probes 48 --size 32x32 --orbit 1 --frames 2 --min-accuracy 0 --quiet";
        let mut args: Vec<&dyn AsRef<OsStr>> = vec![&"embed", &model, &"--key", &key, &"--out", &out];
        let words: Vec<&str> = rest.split(' ').chain(["--message", message]).collect();
        args.extend(words.iter().map(|word| word as &dyn AsRef<OsStr>));
        guard4d(&args)
    };
    embed("id:12:4096").refused(2, &["id 4096", "0 to 4095"]);
    embed("id:12").refused(2, &["message: `id:12`", "id:12:N"]);
    let run = embed("id:12:1234");
    run.done();
    assert!(run.stdout.contains("the number, best of all"), "{}", run.stdout);
    let receipt = Receipt::read(&out.join("private").join(RECEIPT)).expect("our own receipt");
    assert_eq!(receipt.body.promise.payload, Some(IdBits::Twelve));
    let owner = Key::read(&key, &clip).expect("our own key");
    let prf = receipt.body.promise.key_for(&owner).expect("of this asset").prf();
    let message = Payload::parse("id:12:1234", BITS).and_then(|payload| payload.message(&prf)).expect("an id");
    assert!(receipt.commits_to(&message, &prf), "to the number's message");
}

/// One key marks many copies: a leaked one is read although the receipt at hand is of another.
#[test]
fn the_receipt_of_another_copy_will_do() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::new(&gpu, "id:12:7", BITS);
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let path = rigged.file("private").join(RECEIPT);
    let body = Receipt::read(&path).expect("our own receipt").body;
    let owner = Key::read(&rigged.file("owner.key"), &clip).expect("our own key");
    let key = body.promise.key_for(&owner).expect("of this asset");
    let prf = key.prf();
    let other = Payload::parse("id:12:98", BITS).and_then(|payload| payload.message(&prf)).expect("an id");
    std::fs::remove_file(&path).expect("writable");
    let mut promise = body.promise.clone();
    promise.message_mac = other.commitment(&prf);
    let signer = key.signing_key().expect("an owner's key");
    Receipt::seal(ReceiptBody { promise, ..body }, &signer).and_then(|receipt| receipt.write(&path)).expect("writable");
    let report = rigged.verify(0, &[]);
    assert_eq!((&report["id"]["id"], &report["id"]["promised"]), (&json!(7), &json!(98)), "{report}");
    assert_eq!(report["id"]["is_promised"], json!(false), "{report}");
    let text = rigged.verify_with(&rigged.file("owner.key"), &[]);
    assert!(text.stdout.contains("7, not 98, the one of the receipt"), "{}", text.stdout);
    // Claimed beforehand, the receipt's id is compared with the clip, and is not there.
    let claimed = rigged.verify(1, &[&"--message", &"id:12:98"]);
    assert_eq!(claimed["id"]["id"], json!(7), "what is there is told all the same: {claimed}");
}
