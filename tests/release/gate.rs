//! The quality gate: what it asks for, and that nothing but enough passes it.

use std::collections::BTreeMap;

use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::control::{ChanceDeviation, ControlState};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::id_code::IdBits;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::evidence::per_bit::PerBit;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::picture::colour_difference::ColourDifference;
use guard4d_engine::picture::metrics::{Decibels, PsnrSummary, SquaredError};
use guard4d_engine::release::evaluate::{ClassFigure, Evaluation};
use guard4d_engine::release::gate::{Figure, Gate};
use guard4d_engine::scene::camera::classes::CameraClass;
use guard4d_engine::watermark::embed::Aim;
use guard4d_engine::watermark::extractor::rotation::KeyRotation;

fn evaluation(marked: f64, psnr_db: f64) -> Evaluation {
    let psnr = PsnrSummary::of(&[SquaredError { sum: 0.01, num_samples: 300 }]).expect("one view");
    let state = ControlState::Quiet;
    let chance_deviation =
        ChanceDeviation { matches: 48, num_bits: 96, deviation: 0.0, band_low: 36, band_high: 60, state };
    let bits = PerBit {
        clips: 6,
        agreeing: vec![3; 16],
        max_deviation: 0.0,
        constant: 0,
        constant_by_chance: 0.5,
        band_low: 0,
        band_high: 6,
        state,
    };
    Evaluation {
        mode: ExtractorMode::Blind,
        key_rotation: KeyRotation::FIXED,
        clips: 6,
        bits: 16,
        marked,
        marked_frames: marked,
        matches: vec![14; 6],
        ids: None,
        readings: Vec::new(),
        p_values: vec![1e-4, 1e-4, 1e-4, 1e-4, 1e-2, 0.5],
        classes: BTreeMap::new(),
        clean: 0.5,
        clean_leak: chance_deviation.clone(),
        clean_bits: bits.clone(),
        noisy: 0.5,
        noisy_leak: chance_deviation,
        noisy_bits: bits,
        psnr: PsnrSummary { mean_of_views_db: Decibels(psnr_db), ..psnr },
        foreground_psnr: psnr,
        colour_difference: ColourDifference { mean: 1.0, p95: 3.0 },
        ssim: 1.0,
        lpips: None,
    }
}

#[test]
fn by_default_it_asks_for_what_verify_needs() {
    let rate = |bits| Gate::for_bits(bits).fpr;
    assert_eq!((rate(32), rate(48)), (1e-6, 1e-6), "long messages");
    assert_eq!(rate(16), 1e-3, "a short message");
    assert_eq!(rate(8), 1.0 / 256.0, "too short for any verdict: all bits");
    assert_eq!(Gate::after_search(48, 4096).fpr, 1e-6 / 4096.0, "the best of 4096 has to be better");
    let Gate { min_accuracy, min_psnr_db, min_proven, .. } = Gate::for_bits(16);
    assert_eq!((min_accuracy, min_psnr_db), (None, None), "nothing else unless asked for");
    assert_eq!(min_proven, 0.5, "of the clips, each alone");
}

#[test]
fn clips_that_give_back_the_number_are_counted() {
    let prf = Prf::new(&MasterSecret::from_bytes([3; 32]));
    let message = Payload::parse("id:12:1234", 48).and_then(|payload| payload.message(&prf)).expect("an id");
    let other = Payload::parse("id:12:1235", 48).and_then(|payload| payload.message(&prf)).expect("an id");
    let sure = |message: &Message| message.bits().map(|bit| if bit { 2.0 } else { -2.0 }).collect::<Vec<f32>>();
    let read = |logits: &[f32]| Reading::from_logits(logits, 48).expect("48 numbers");
    let mut damaged = sure(&message);
    damaged[..5].iter_mut().for_each(|logit| *logit *= -1.0);
    let mut evaluation = evaluation(0.9, 43.0);
    evaluation.readings = vec![read(&sure(&message)), read(&damaged), read(&sure(&other))];
    evaluation.count_ids(IdBits::Twelve, &prf, &message).expect("a length of the code");
    assert_eq!(evaluation.ids, Some(2), "five wrong bits do not matter, another number does");
    let short = Payload::parse("hex:ab", 8).and_then(|payload| payload.message(&prf)).expect("a message");
    let refused = evaluation.count_ids(IdBits::Twelve, &prf, &short).expect_err("8 bits carry no such number");
    assert!(matches!(refused, EngineError::Usage { .. }), "{refused}");
}

#[test]
fn training_that_ends_in_time_aims_at_it() {
    let gate = Gate::for_bits(16);
    assert_eq!(gate.aim(), Aim { p_value: 1e-3, proven: 0.75, accuracy: 0.0 });
    let other = Gate { min_proven: 0.0, min_accuracy: Some(0.9), ..gate.clone() };
    assert_eq!(other.aim(), Aim { p_value: gate.fpr, proven: 0.0, accuracy: 0.9 }, "bits alone");
}

#[test]
fn figures_below_their_bound_are_named() {
    let gate = Gate { min_accuracy: Some(0.875), min_psnr_db: Some(43.0), ..Gate::for_bits(16) };
    assert_eq!(gate.missed(&evaluation(0.875, 43.0)), [], "the bound itself passes");
    assert_eq!(gate.missed(&evaluation(1.0, f64::INFINITY)), [], "identical pictures");
    assert_eq!(
        gate.missed(&evaluation(0.875 - 1e-15, 43.0)),
        [],
        "a sum of fractions may come out a rounding error low"
    );
    let missed = gate.missed(&evaluation(0.8125, 41.5));
    assert_eq!(missed.iter().map(|m| m.field).collect::<Vec<_>>(), [Figure::BitAccuracy, Figure::Psnr], "both");
    assert_eq!(missed[0].to_string(), "bits right on marked clips: 81.2 %, expected at least 87.5 %");
    assert_eq!(missed[1].to_string(), "PSNR of whole frames: 41.50 dB, expected at least 43.00 dB");
    assert_eq!(gate.missed(&evaluation(f64::NAN, f64::NAN)).len(), 2, "what is no number falls short");
    assert_eq!(Gate { min_psnr_db: None, ..gate }.missed(&evaluation(1.0, f64::NAN)), [], "nothing was asked");
}

#[test]
fn clips_that_prove_nothing_alone_are_counted() {
    let fine = evaluation(0.9, 43.0);
    let missed = |rate: f64| Gate { fpr: rate, ..Gate::for_bits(16) }.missed(&fine);
    assert_eq!(missed(1e-4), [], "four of six");
    let [short] = missed(1e-5)[..] else { panic!("{:?}", missed(1e-5)) };
    assert_eq!(short.to_string(), "marked clips that prove the message alone: 0.0 %, expected at least 50.0 %");
    let worse = Evaluation { p_values: vec![1e-4, 1e-4, f64::NAN, f64::NAN, f64::NAN, 0.5], ..fine.clone() };
    assert_eq!(Gate::for_bits(16).missed(&worse)[0].field, Figure::Proven, "two of six, and what is no number");
    let none = Evaluation { p_values: Vec::new(), ..fine };
    assert_eq!(Gate::for_bits(16).missed(&none).len(), 1, "no clip proves nothing");
}

#[test]
fn a_class_of_films_can_be_asked_for() {
    let above = ClassFigure { films: 2, frames: 8, bit_accuracy: 0.875, proven: 1.0 };
    let measured = Evaluation { classes: BTreeMap::from([(CameraClass::Above, above)]), ..evaluation(1.0, 50.0) };
    let gate = |class, share| Gate { min_class_accuracy: BTreeMap::from([(class, share)]), ..Gate::for_bits(16) };
    assert_eq!(gate(CameraClass::Above, 0.875).missed(&measured), [], "the bound itself passes");
    let [short] = gate(CameraClass::Above, 0.9).missed(&measured)[..] else { panic!("one figure") };
    let text = "bits right in films of the class `above`: 87.5 %, expected at least 90.0 %";
    assert_eq!(short.to_string(), text, "said by name");
    let missed = gate(CameraClass::Below, 0.1).missed(&measured);
    assert_eq!(missed.len(), 1, "what was not measured falls short");
}

#[test]
fn bounds_that_are_none_are_refused() {
    let fine = Gate { min_accuracy: Some(1.0), min_psnr_db: Some(-3.0), ..Gate::for_bits(16) };
    fine.validate().expect("all bits, any picture");
    for gate in [
        Gate { min_proven: f64::NAN, ..fine.clone() },
        Gate { min_accuracy: Some(1.5), ..fine.clone() },
        Gate { min_accuracy: Some(-0.1), ..fine.clone() },
        Gate { min_accuracy: Some(f64::NAN), ..fine.clone() },
        Gate { min_psnr_db: Some(f64::NAN), ..fine.clone() },
        Gate { min_psnr_db: Some(f64::INFINITY), ..fine.clone() },
        Gate { min_class_accuracy: BTreeMap::from([(CameraClass::Above, 1.5)]), ..fine },
    ] {
        assert_eq!(gate.validate().expect_err("no bound").exit_code(), 2, "{gate:?}");
    }
}
