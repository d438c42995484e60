//! Receipts: sealed, read back, and refused when changed.

use std::collections::BTreeMap;
use std::fs;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::base::signature::SigningKey;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::id_code::IdBits;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::thresholds::Thresholds;
use guard4d_engine::picture::metrics::{Decibels, PsnrSummary, SquaredError};
use guard4d_engine::release::evaluate::ClassFigure;
use guard4d_engine::release::receipt::{
    Anchor, BitAccuracies, DeviceRecord, Figures, FileRecord, OwnerChips, Promise, Receipt, ReceiptBody, Repeatability,
    Tool,
};
use guard4d_engine::scene::camera::classes::CameraClass;
use serde_json::Value;

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

fn message() -> Message {
    Message::from_value(0xcafe_f00d, 32).expect("32 bits")
}

pub(crate) fn body() -> ReceiptBody {
    let psnr = PsnrSummary::of(&[SquaredError { sum: 0.011, num_samples: 300 }]).expect("one view");
    ReceiptBody {
        tool: Tool::current(),
        promise: Promise {
            key_id: prf(1).key_id(),
            num_bits: 32,
            message_mac: message().commitment(&prf(1)),
            payload: Some(IdBits::Twelve),
            token_table: Digest::of(b"table"),
            decoder: Digest::of(b"decoder"),
            extractor_mode: ExtractorMode::Blind,
            extractor: Some(Digest::of(b"extractor")),
            clip: Digest::of(b"clip"),
            preprocess: "bilinear-aa/1".to_owned(),
            thresholds: Thresholds::default(),
            owner_chips: Some(OwnerChips { strength: 0.5 }),
            anchor: Some(Anchor {
                asset: Digest::of(b"asset"),
                scene: Digest::of(b"scene"),
                reader: Digest::of(b"reader"),
                signer: signer().public_key(),
            }),
        },
        inputs: vec![FileRecord { path: "point_cloud.ply".to_owned(), blake3: Digest::of(b"in") }],
        outputs: vec![FileRecord { path: "point_cloud.ply".to_owned(), blake3: Digest::of(b"out") }],
        settings: serde_json::json!({"seed": 42, "lr": 0.005, "views": ["a", "b"], "undo": null, "fit": true}),
        figures: Figures {
            psnr,
            foreground_psnr: Some(PsnrSummary { mean_of_views_db: Decibels(f64::INFINITY), ..psnr }),
            ssim: 0.1 + 0.2,
            lpips: None,
            bit_accuracy: BitAccuracies { frame: 0.943, clip: 1.0, clean: Some(0.5), noisy: None },
            classes: BTreeMap::from([(
                CameraClass::OffCentre,
                ClassFigure { films: 2, frames: 8, bit_accuracy: 0.875, proven: 0.5 },
            )]),
        },
        seconds: BTreeMap::from([("plan".to_owned(), 1.25), ("embed".to_owned(), 1e-7 / 3.0)]),
        peak_memory_bytes: Some(123_456_789_012),
        device: DeviceRecord {
            name: "test".to_owned(),
            driver: "none 1".to_owned(),
            kernels: Some("lanes".to_owned()),
            api_version: "1.2".to_owned(),
            repeatability: Repeatability::SameBytes,
        },
    }
}

/// Whose receipts these are.
pub(crate) fn signer() -> SigningKey {
    SigningKey::from_seed(&[9; 32])
}

fn sealed() -> Receipt {
    Receipt::seal(body(), &signer()).expect("finite figures")
}

#[test]
fn receipts_round_trip_through_a_file() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("receipt.json");
    let receipt = sealed();
    receipt.write(&path).expect("the folder is writable");
    assert_eq!(Receipt::read(&path).expect("our own receipt"), receipt);
    assert_eq!(receipt.write(&path).expect_err("it exists").exit_code(), 73);
    let text = fs::read_to_string(&path).expect("written above");
    assert!(text.contains("\"guard4d.receipt/3\"") && text.contains("\"inf\""), "{text}");
    assert!(!text.contains("cafef00d") && !text.contains("3405705229"), "the message stays hidden");
}

#[test]
fn layout_of_the_file_does_not_matter() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("receipt.json");
    fs::write(&path, serde_json::to_string(&sealed()).expect("finite figures")).expect("the folder is writable");
    assert_eq!(Receipt::read(&path).expect("compact JSON"), sealed());
}

#[test]
fn receipts_from_before_memory_ids_and_chips_are_read() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("receipt.json");
    let promise = Promise { payload: None, owner_chips: None, ..body().promise };
    let earlier =
        Receipt::seal(ReceiptBody { peak_memory_bytes: None, promise, ..body() }, &signer()).expect("finite figures");
    earlier.write(&path).expect("the folder is writable");
    let text = fs::read_to_string(&path).expect("written above");
    assert!(
        !text.contains("peak_memory_bytes") && !text.contains("payload") && !text.contains("chips"),
        "as an earlier version wrote it: {text}"
    );
    assert_eq!(Receipt::read(&path).expect("its commitment holds"), earlier);
}

/// Paths to every leaf of a JSON value.
fn leaves(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(fields) => fields.iter().for_each(|(name, v)| leaves(v, &format!("{at}/{name}"), found)),
        Value::Array(items) => items.iter().enumerate().for_each(|(i, v)| leaves(v, &format!("{at}/{i}"), found)),
        _ => found.push(at.to_owned()),
    }
}

fn changed(leaf: &Value) -> Value {
    match leaf {
        Value::Null => Value::from(0.25),
        Value::Bool(b) => Value::from(!b),
        Value::Number(n) if n.is_u64() => Value::from(n.as_u64().expect("asked above") + 1),
        Value::Number(n) => Value::from(n.as_f64().expect("a double").next_up()),
        Value::String(text) if text.len() == 64 => Value::from(Digest::of(text.as_bytes()).to_string()),
        Value::String(text) if text == "inf" => Value::from(50.0),
        Value::String(text) => Value::from(format!("{text}x")),
        other => other.clone(),
    }
}

#[test]
fn every_single_change_is_noticed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("receipt.json");
    let whole = serde_json::to_value(sealed()).expect("finite figures");
    let mut found = Vec::new();
    leaves(&whole, "", &mut found);
    assert!(found.len() > 50, "{} leaves", found.len());
    for at in found {
        let mut copy = whole.clone();
        let leaf = copy.pointer_mut(&at).expect("listed above");
        *leaf = changed(leaf);
        fs::write(&path, copy.to_string()).expect("the folder is writable");
        let error = Receipt::read(&path).expect_err(&at);
        assert_eq!(error.exit_code(), 65, "{at}: {error}");
    }
}

#[test]
fn foreign_fields_versions_and_ruins_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("receipt.json");
    let text = serde_json::to_string(&sealed()).expect("finite figures");
    let refuse = |bytes: &[u8]| {
        fs::write(&path, bytes).expect("the folder is writable");
        let error = Receipt::read(&path).expect_err("refused");
        assert_eq!(error.exit_code(), 65, "{error}");
        error.to_string()
    };
    assert!(refuse(text.replacen("\"seconds\"", "\"minutes\"", 1).as_bytes()).contains("minutes"), "unknown field");
    assert!(refuse(text.replace("receipt/3", "receipt/4").as_bytes()).contains("receipt/4"), "unknown version");
    refuse(text.replacen("\"body\":", "\"extra\":1,\"body\":", 1).as_bytes());
    refuse(&text.as_bytes()[..text.len() / 2]);
    refuse(b"");
    refuse(b"\xff\xfe");
    refuse(&b"[".repeat(100_000));
    assert_eq!(Receipt::read(&folder.path().join("nowhere.json")).expect_err("missing").exit_code(), 66);
    assert_eq!(sealed().write(&folder.path().join("no/receipt.json")).expect_err("no folder").exit_code(), 73);
}

#[test]
fn figures_that_are_no_numbers_are_not_sealed() {
    let mut ssim = body();
    ssim.figures.ssim = f64::NAN;
    let mut seconds = body();
    seconds.seconds.insert("verify".to_owned(), f64::INFINITY);
    let mut psnr = body();
    psnr.figures.psnr.min_db = Decibels(f64::NAN);
    let mut clean = body();
    clean.figures.bit_accuracy.clean = Some(f64::NAN);
    let mut class = body();
    let figure = ClassFigure { films: 2, frames: 8, bit_accuracy: f64::NAN, proven: 0.5 };
    class.figures.classes.insert(CameraClass::Above, figure);
    let mut chips = body();
    chips.promise.owner_chips = Some(OwnerChips { strength: f64::INFINITY });
    for bad in [ssim, seconds, psnr, clean, class, chips] {
        assert_eq!(Receipt::seal(bad, &signer()).expect_err("no number").exit_code(), 70);
    }
}

#[test]
fn receipts_commit_to_one_message_of_one_key() {
    let receipt = sealed();
    assert!(receipt.commits_to(&message(), &prf(1)), "the owner's own");
    assert!(!receipt.commits_to(&message(), &prf(2)), "another key");
    assert!(!receipt.commits_to(&message().inverted(), &prf(1)), "another message");
    let longer = Message::from_value(message().value(), 33).expect("33 bits");
    assert!(!receipt.commits_to(&longer, &prf(1)), "another length");
}

#[test]
fn files_are_hashed_as_memory_is() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    fs::write(folder.path().join("x.ply"), vec![7; 200_000]).expect("the folder is writable");
    let record = FileRecord::of(folder.path(), "x.ply").expect("it exists");
    assert_eq!(record.blake3, Digest::of(&[7; 200_000]));
    assert_eq!(FileRecord::of(folder.path(), "y.ply").expect_err("missing").exit_code(), 66);
    // Published test vector of BLAKE3 for the empty input.
    let empty = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";
    assert_eq!(Digest::of(b"").to_string(), empty);
    assert_eq!(Digest::from_hex(empty), Some(Digest::of(b"")));
    assert_eq!(Digest::from_hex("af13"), None);
}
