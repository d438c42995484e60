//! A mark at other strengths.

use guard4d_engine::watermark::embed::Embedding;
use guard4d_engine::watermark::evaluate::HeldOut;
use guard4d_engine::watermark::sweep::{FACTORS, sweep};

use crate::support::gpu::device;
use crate::support::owner::{BITS, Owner, cameras};

#[test]
fn a_sweep_begins_at_the_clean_clip_and_passes_through_the_mark() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let subject = owner.subject(&gpu);
    let mut embedding = Embedding::prepare(subject, owner.config.clone()).expect("prepares");
    while embedding.step().expect("steps").is_some() {}
    let embedded = embedding.finish().expect("finishes");
    let film = HeldOut::shoot(&gpu, &owner.model, &embedded.sh_coeffs, &cameras()).expect("films");
    let evaluation = film.evaluate(&gpu, &owner.clip, &owner.key, &embedded.extractor, &owner.message).expect("reads");

    let run = |factors: &[f32]| sweep(&subject, &embedded.extractor, &embedded.sh_coeffs, factors, &cameras());
    let points = run(&FACTORS).expect("sweeps");
    assert_eq!(points.iter().map(|p| p.factor).collect::<Vec<_>>(), FACTORS);
    assert!(points.iter().all(|p| p.bits == BITS && p.matches.len() == 1), "one clip each: {points:?}");
    assert_eq!(points[0].leak, evaluation.clean_leak, "no mark is the clean clip");
    let own = &points[4];
    // Of the mark's own strength up to the rounding of a difference and a sum, which 8 bits swallow.
    assert_eq!((own.factor, &own.matches), (1.0, &evaluation.matches));
    assert!((own.accuracy() - evaluation.marked).abs() < 1e-9, "{} of {}", own.accuracy(), evaluation.marked);
    let db: Vec<f64> = points.iter().map(|p| p.psnr.pooled_db.0).collect();
    // Rounding to 8 bits alone is 1/12 of a step squared, where nothing is saturated.
    assert!(db[0] > 20.0 * 255f64.log10() + 10.0 * 12f64.log10() - 0.5 && db[0].is_finite(), "{db:?}");
    assert!(db.windows(2).all(|pair| pair[1] < pair[0]), "stronger marks cost more: {db:?}");

    assert_eq!(run(&[]).expect("sweeps").len(), 0);
    for wrong in [-1.0, f32::NAN, f32::INFINITY] {
        assert_eq!(run(&[wrong]).expect_err("no strength").exit_code(), 2, "{wrong}");
    }
    let short = &embedded.sh_coeffs[48..];
    let refused = sweep(&subject, &embedded.extractor, short, &FACTORS, &cameras()).expect_err("another model's");
    assert_eq!(refused.exit_code(), 2, "{refused}");
}
