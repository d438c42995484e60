//! The quality gate: what it asks for, and that nothing but enough passes it.

use guard4d_engine::watermark::evaluate::Evaluation;
use guard4d_engine::watermark::evidence::ExtractorMode;
use guard4d_engine::watermark::gate::{Figure, Gate};
use guard4d_engine::watermark::metrics::{Decibels, PsnrSummary, SquaredError};
use guard4d_engine::watermark::null_panel::{ControlState, Leak};
use guard4d_engine::watermark::per_bit::PerBit;

fn evaluation(marked: f64, psnr_db: f64) -> Evaluation {
    let psnr = PsnrSummary::of(&[SquaredError { sum: 0.01, num_samples: 300 }]).expect("one view");
    let state = ControlState::Quiet;
    let leak = Leak { matches: 48, num_bits: 96, deviation: 0.0, band_low: 36, band_high: 60, state };
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
        clips: 6,
        bits: 16,
        marked,
        marked_frames: marked,
        matches: vec![14; 6],
        clean: 0.5,
        clean_leak: leak.clone(),
        clean_bits: bits.clone(),
        noisy: 0.5,
        noisy_leak: leak,
        noisy_bits: bits,
        psnr: PsnrSummary { mean_of_views_db: Decibels(psnr_db), ..psnr },
        foreground_psnr: psnr,
        ssim: 1.0,
        lpips: None,
    }
}

#[test]
fn by_default_it_asks_for_what_verify_needs() {
    let share = |bits| Gate::for_bits(bits).min_accuracy;
    // Binomial tails: 30 of 32 and 41 of 48 matches reach 1e-6; 15 of 16 reach 1e-3, the rate of short messages.
    assert_eq!((share(32), share(48)), (30.0 / 32.0, 41.0 / 48.0), "long messages");
    assert_eq!(share(16), 15.0 / 16.0, "a short message");
    assert_eq!(share(8), 1.0, "too short for any verdict");
    assert_eq!(Gate::after_search(48, 4096).min_accuracy, 45.0 / 48.0, "the best of 4096 has to be better");
    assert_eq!(Gate::for_bits(16).min_psnr_db, None, "no fidelity unless asked for");
}

#[test]
fn figures_below_their_bound_are_named() {
    let gate = Gate { min_accuracy: 0.875, min_psnr_db: Some(43.0) };
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
fn bounds_that_are_none_are_refused() {
    let fine = Gate { min_accuracy: 1.0, min_psnr_db: Some(-3.0) };
    fine.validate().expect("all bits, any picture");
    for gate in [
        Gate { min_accuracy: 1.5, ..fine },
        Gate { min_accuracy: -0.1, ..fine },
        Gate { min_accuracy: f64::NAN, ..fine },
        Gate { min_psnr_db: Some(f64::NAN), ..fine },
        Gate { min_psnr_db: Some(f64::INFINITY), ..fine },
    ] {
        assert_eq!(gate.validate().expect_err("no bound").exit_code(), 2, "{gate:?}");
    }
}
