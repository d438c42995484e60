//! Bounds against enumeration, against the normal law, and against their own inverse.

use guard4d_engine::evidence::score_tail::{ScoreTail, TwoValued};

use crate::support::random::Random;

/// Positions whose score has mean 0 and variance 1 by chance, of these probabilities in turn.
fn unit_terms(probabilities: &[f64], positions: usize) -> Vec<TwoValued> {
    let term = |p: f64| TwoValued { high: ((1.0 - p) / p).sqrt(), low: -(p / (1.0 - p)).sqrt(), probability: p };
    (0..positions).map(|i| term(probabilities[i % probabilities.len()])).collect()
}

/// Every score of few terms with its probability.
fn all_scores(terms: &[TwoValued]) -> Vec<(f64, f64)> {
    (0..1u32 << terms.len())
        .map(|word| {
            terms.iter().enumerate().fold((0.0, 1.0), |(score, p), (i, term)| match word >> i & 1 {
                1 => (score + term.high, p * term.probability),
                _ => (score + term.low, p * (1.0 - term.probability)),
            })
        })
        .collect()
}

#[test]
fn the_bound_is_above_every_tail_and_the_estimate_near_it() {
    let mut random = Random(5);
    for round in 0..4 {
        let mut terms = unit_terms(&[0.1127, 0.5, 0.8873], 12);
        for term in &mut terms {
            // Evidence of either sign, of very different weight.
            let weight = f64::from(random.vec_f32(1, -1.0, 1.0)[0]).powi(3);
            (term.high, term.low) = (weight * term.high, weight * term.low);
        }
        let tail = ScoreTail::new(terms.clone());
        let scores = all_scores(&terms);
        let mut close = 0;
        for &(score, _) in scores.iter().step_by(17) {
            // The sums are the same to rounding; what is equal counts.
            let exact: f64 = scores.iter().filter(|(other, _)| *other >= score - 1e-12).map(|(_, p)| p).sum();
            let told = tail.log_tail(score);
            assert!(told.bound >= exact.ln() - 1e-9, "{round}: {} for {}", told.bound, exact.ln());
            assert!(told.bound <= 0.0, "a probability");
            close += u32::from((told.estimate - exact.ln()).abs() < 0.7);
        }
        // Twelve terms are few for a law of large numbers: a factor of two, nearly always.
        assert!(close > 200, "{round}: {close} of {} estimates are close", scores.len().div_ceil(17));
    }
}

#[test]
fn many_terms_follow_the_normal_law_and_the_bound_is_the_published_one() {
    let plain = ScoreTail::new(unit_terms(&[0.5], 1_000_000));
    let biased = ScoreTail::new(unit_terms(&[0.11270, 0.5, 0.88730], 20_001));
    for (name, tail, positions) in [("plain", &plain, 1_000_000.0f64), ("biased", &biased, 20_001.0)] {
        assert!(tail.mean().abs() < 1e-9 * positions, "{name}: {}", tail.mean());
        assert!((tail.deviation() / positions.sqrt() - 1.0).abs() < 1e-9, "{name}: {}", tail.deviation());
        let at = |t: f64| tail.log_tail(t * positions.sqrt());
        // Q(3) = 1.349 90e-3; the next order of 20,000 biased terms is 1/√20,000 of it times the skewness, which is 0.
        assert!((at(3.0).estimate.exp() / 1.349_90e-3 - 1.0).abs() < 5e-3, "{name}: {}", at(3.0).estimate.exp());
        // exp(−T²/2) to what 4th cumulants change at T = 8: T⁴/24 · κ₄/N, with κ₄ = 3.5 on average.
        let decades = at(8.0).bound / 10f64.ln();
        assert!((decades + 13.897).abs() < 0.05, "{name}: {decades}");
    }
    // Half of all scores lie above the mean.
    assert_eq!(plain.log_tail(0.0).bound, 0.0);
    assert!((plain.log_tail(1e-3).estimate.exp() - 0.5).abs() < 1e-3);
}

#[test]
fn required_scores_are_the_inverse() {
    let tail = ScoreTail::new(unit_terms(&[0.11270, 0.5, 0.88730], 3000));
    for log_p in [-1.0, -13.8, -27.6, -100.0] {
        let score = tail.required_score(log_p).expect("there is one");
        let off = tail.log_tail(score).bound - log_p;
        assert!((-1e-2..=0.0).contains(&off), "{log_p}: off by {off}");
    }
    // Three coins: no score is rarer than 1 in 8.
    let few = ScoreTail::new(unit_terms(&[0.5], 3));
    assert_eq!(few.required_score(-3.0), None);
    let all_three = few.log_tail(3.0).bound;
    assert!((all_three - 0.125f64.ln()).abs() < 1e-3, "{all_three}");
}

#[test]
fn what_is_no_number_proves_nothing() {
    let tail = ScoreTail::new(unit_terms(&[0.5], 8));
    assert!(tail.log_tail(f64::NAN).bound.is_nan());
    let mut terms = unit_terms(&[0.5], 8);
    terms[3].high = f64::NAN;
    let tail = ScoreTail::new(terms).log_tail(2.0);
    assert!(tail.bound.is_nan() && tail.estimate.is_nan(), "{tail:?}");
    // Evidence of nothing at all: any score is as good as any other.
    let nothing = ScoreTail::new(vec![TwoValued { high: 0.0, low: 0.0, probability: 0.5 }; 8]);
    assert_eq!(nothing.log_tail(0.0).bound, 0.0);
}
