//! Published thresholds, exactness against enumeration, uniformity under biased extractors.

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose, standard_normal};
use guard4d_engine::evidence::id_code::IdBits;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::statistics::{
    SoftScoreNull, binomial_tail, chance_band, empirical_fpr_bound, match_p_value, required_matches, shown_thresholds,
};

use crate::support::close::largest;

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

/// Relative tolerance of a correctly rounded figure recomputed in other units.
fn same(got: f64, want: f64, relative: f64) -> bool {
    (got - want).abs() <= relative * want.abs()
}

#[test]
fn thresholds_are_the_published_ones() {
    let rows = [
        (16, [Some(15), None, None]),
        (32, [Some(26), Some(30), Some(32)]),
        (48, [Some(36), Some(41), Some(44)]),
        (64, [Some(45), Some(51), Some(56)]),
        (72, [Some(50), Some(57), Some(61)]),
        (96, [Some(64), Some(72), Some(77)]),
    ];
    for (num_bits, want) in rows {
        assert_eq!([1e-3, 1e-6, 1e-9].map(|fpr| required_matches(num_bits, fpr)), want, "{num_bits} bits");
        assert_eq!(shown_thresholds(num_bits, 1), want, "{num_bits} bits");
    }
    assert_eq!(required_matches(16, f64::NAN), None);
}

/// The table in the docs is the program's; it has more lengths than the published one, and the best of all ids.
#[test]
fn the_table_for_users_is_true() {
    let text =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/method/evidence.md")).expect("it is there");
    let (header, rows) =
        text.split_once("| key | 1e-3 | 1e-6 | 1e-9 | `id:12`: 1e-3 | 1e-6 | 1e-9 |").expect("a table");
    assert!(!header.is_empty(), "something stands before it");
    let mut lengths = Vec::new();
    for row in rows.lines().skip(2).map_while(|line| line.trim().strip_prefix("| ")) {
        let cells: Vec<&str> = row.trim_end_matches(" |").split(" | ").collect();
        let num_bits: u32 = cells[0].trim_end_matches(" bits").parse().expect("a length");
        let shown = |needed: Option<u32>| needed.map_or("–".to_owned(), |k| k.to_string());
        let row = [1, IdBits::Twelve.num_ids()].map(|searched| shown_thresholds(num_bits, searched).map(shown));
        assert_eq!(cells[1..], row.concat(), "{num_bits} bits");
        lengths.push(num_bits);
    }
    assert_eq!(lengths, [8, 16, 24, 32, 48, 64, 72, 96, 128]);
}

#[test]
fn p_values_are_the_published_ones() {
    let rows =
        [(16, 16, 1.5e-5), (16, 15, 2.6e-4), (32, 30, 1.2e-7), (32, 28, 9.7e-6), (48, 43, 6.8e-9), (48, 42, 5.0e-8)];
    for (num_bits, matches, want) in rows {
        // Two published digits.
        assert!(same(match_p_value(matches, num_bits), want, 0.04), "{matches} of {num_bits}");
    }
    // Rational arithmetic with arbitrary precision gives this double.
    assert!(same(match_p_value(100, 128), 5.4757299481428744e-11, 1e-15), "100 of 128");
}

#[test]
fn p_values_are_exact_at_the_ends() {
    for num_bits in 1..=128 {
        assert_eq!(match_p_value(0, num_bits), 1.0);
        assert_eq!(match_p_value(num_bits, num_bits), 0.5_f64.powi(num_bits as i32));
        assert_eq!(match_p_value(num_bits + 1, num_bits), 0.0);
        let falls = (0..num_bits).all(|k| match_p_value(k, num_bits) > match_p_value(k + 1, num_bits));
        // Near 0 matches the tail differs from 1 by less than a double can show.
        assert!(falls || num_bits > 50, "{num_bits}");
    }
}

#[test]
fn chance_band_is_two_sided() {
    // 14 of 16 or more have 137/65536 = 0.21 %, 13 or more 1.06 %; half a percent is allowed on each side.
    assert_eq!(chance_band(16, 0.99).expect("a confidence"), 3..=13);
    assert_eq!(chance_band(128, 0.99).expect("a confidence"), 49..=79);
    assert_eq!(chance_band(4, 0.99).expect("a confidence"), 0..=4, "four bits cannot leave the band");
    for confidence in [1.0, -0.1, f64::NAN, f64::INFINITY] {
        assert!(chance_band(16, confidence).is_err(), "{confidence}");
    }
    for num_bits in 8..=128 {
        let band = chance_band(num_bits, 0.99).expect("a confidence");
        let outside = 2.0 * match_p_value(band.end() + 1, num_bits);
        assert!(outside <= 0.01, "{num_bits}: {outside}");
        assert_eq!(band.start() + band.end(), num_bits);
    }
}

#[test]
fn chance_band_serves_the_bits_of_many_clips() {
    // Exact rational arithmetic gives these; 128 bits is where the integers end and the logarithms begin.
    let rows = [(96, 35..=61), (128, 49..=79), (144, 57..=87), (192, 78..=114), (288, 122..=166), (768, 348..=420)];
    for (num_bits, want) in rows {
        assert_eq!(chance_band(num_bits, 0.99).expect("a confidence"), want, "{num_bits} bits");
    }
}

#[test]
fn empirical_bound_never_claims_more_than_was_tried() {
    assert!(same(empirical_fpr_bound(0, 999), 1e-3, 1e-15), "1000 clips support 1e-3");
    assert_eq!(empirical_fpr_bound(0, 0), 1.0);
    assert_eq!(empirical_fpr_bound(3, 3), 1.0);
}

#[test]
fn binomial_tail_agrees_with_the_exact_one() {
    for (k, n) in [(0, 20), (1, 20), (15, 20), (20, 20), (100, 128), (64, 128)] {
        assert!(same(binomial_tail(k, n, 0.5), match_p_value(k, n), 1e-11), "{k} of {n}");
    }
    // 1 - (1 - 1e-6)^1000.
    assert!(same(binomial_tail(1, 1000, 1e-6), 9.995_006_661_255_913e-4, 1e-9), "rare events");
    assert_eq!(binomial_tail(1, 1000, 0.0), 0.0);
    assert_eq!(binomial_tail(1, 1000, 1.0), 1.0);
    assert!(binomial_tail(1, 10, f64::NAN).is_nan(), "NaN stays NaN");
}

/// Integer logits with the largest at 1023 are not changed by rounding, so enumeration must agree exactly.
#[test]
fn soft_score_is_exact_for_integer_logits() {
    let logits = [1023.0, -1000.0, 3.0, 0.0, 77.0, -512.0, 512.0, -1.0, 640.0, 2.0];
    let num_bits = logits.len() as u32;
    let null = SoftScoreNull::new(&logits).expect("finite");
    let all: Vec<_> = (0..1 << num_bits).map(|v| Message::from_value(v, num_bits).expect("it fits")).collect();
    let score = |m: &Message| -> f64 { m.bits().zip(logits).map(|(bit, o)| if bit { o } else { -o }).sum() };
    for message in &all {
        let as_good = all.iter().filter(|other| score(other) >= score(message)).count();
        let p = null.p_value(message).expect("equal lengths");
        assert_eq!(p, as_good as f64 / all.len() as f64, "{message}");
    }
}

/// Rounding moves each score by at most L/2 levels, so the p-value lies between those of scores that far away.
#[test]
fn rounding_of_logits_moves_the_p_value_within_its_bound() {
    let rng = &mut prf(1).stream(Purpose::Embedding, 0);
    let logits: Vec<f64> = (0..14).map(|_| standard_normal(rng)).collect();
    let most = largest(logits.iter().map(|o| o.abs()));
    let slack = 14.0 * most / 1023.0;
    let null = SoftScoreNull::new(&logits).expect("finite");
    let score = |value: u128| -> f64 {
        let message = Message::from_value(value, 14).expect("it fits");
        message.bits().zip(&logits).map(|(bit, &o)| if bit { o } else { -o }).sum()
    };
    let scores: Vec<f64> = (0..1 << 14).map(score).collect();
    for value in (0..1 << 14).step_by(611) {
        let p = null.p_value(&Message::from_value(value, 14).expect("it fits")).expect("equal lengths");
        let above = |by: f64| scores.iter().filter(|s| **s >= score(value) + by).count() as f64 / 16384.0;
        assert!(above(slack) <= p && p <= above(-slack), "{value}: {p}");
    }
}

#[test]
fn soft_score_reaches_the_smallest_p_value_of_every_length() {
    for num_bits in [1, 16, 32, 48, 64, 128] {
        let logits: Vec<f64> = (0..num_bits).map(|i| if i % 3 == 0 { -1.0 } else { 1.5 }).collect();
        let null = SoftScoreNull::new(&logits).expect("finite");
        let bits: Vec<bool> = logits.iter().map(|o| *o > 0.0).collect();
        let read = Message::from_bits(&bits).expect("1 to 128 bits");
        assert_eq!(null.p_value(&read).expect("equal lengths"), 0.5_f64.powi(num_bits));
        assert_eq!(null.p_value(&read.inverted()).expect("equal lengths"), 1.0);
    }
}

#[test]
fn soft_score_of_equal_logits_is_the_match_test() {
    let null = SoftScoreNull::new(&[0.7; 40]).expect("finite");
    for matches in 0..=40 {
        let value = if matches == 0 { 0 } else { u128::MAX >> (128 - matches) };
        let p = null.p_value(&Message::from_value(value, 40).expect("it fits")).expect("equal lengths");
        assert_eq!(p, match_p_value(matches, 40), "{matches}");
    }
}

#[test]
fn soft_score_refuses_what_is_no_number() {
    for poison in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(SoftScoreNull::new(&[1.0, poison]).expect_err("poison").exit_code(), 70);
    }
    assert!(SoftScoreNull::new(&[]).is_err() && SoftScoreNull::new(&[1.0; 129]).is_err(), "lengths");
    let silent = SoftScoreNull::new(&[0.0; 8]).expect("finite");
    let message = Message::from_value(3, 8).expect("it fits");
    assert_eq!(silent.p_value(&message).expect("equal lengths"), 1.0, "nothing was said");
    assert!(silent.p_value(&Message::from_value(3, 9).expect("it fits")).is_err(), "lengths");
    let faint = SoftScoreNull::new(&[f64::MIN_POSITIVE, -f64::MIN_POSITIVE / 4.0]).expect("finite");
    assert_eq!(faint.p_value(&Message::from_value(0b10, 2).expect("it fits")).expect("equal lengths"), 0.25);
}

/// Extractors that recite, lean to one side or let few bits decide still give uniform p-values over messages.
#[test]
fn p_values_are_uniform_for_biased_extractors() {
    const TRIALS: u32 = 20_000;
    let rng = &mut prf(5).stream(Purpose::Embedding, 1);
    let leaning: Vec<f64> = (0..32).map(|_| 2.0 + 0.3 * standard_normal(rng)).collect();
    let uneven: Vec<f64> = (0..32).map(|_| standard_normal(rng).powi(3)).collect();
    let alternating: Vec<f64> = (0..32).map(|i| if i % 2 == 0 { 1.0 } else { -0.5 }).collect();
    for (logits, has_ties) in [(leaning, false), (uneven, false), (alternating, true)] {
        let (mut soft, matched) = p_values_of_random_messages(&logits, TRIALS);
        for alpha in [0.001, 0.01, 0.05, 0.2, 0.5, 0.9] {
            let rate = |p: &[f64]| p.iter().filter(|p| **p <= alpha).count() as f64 / f64::from(TRIALS);
            // Never more often than alpha, beyond five standard errors.
            let slack = 5.0 * (alpha * (1.0 - alpha) / f64::from(TRIALS)).sqrt();
            assert!(rate(&soft) <= alpha + slack, "soft {alpha}: {}", rate(&soft));
            assert!(rate(&matched) <= alpha + slack, "matches {alpha}: {}", rate(&matched));
        }
        soft.sort_by(f64::total_cmp);
        let gap = |(i, p): (usize, &f64)| (p - i as f64 / f64::from(TRIALS)).abs();
        let widest = largest(soft.iter().enumerate().map(gap));
        // Kolmogorov and Smirnov: sqrt(ln(2/delta) / 2n) = 0.023 at delta = 1e-9. Scores that many messages
        // share make the p-value larger than uniform, so equal weights are tried by the bound above only.
        assert!(has_ties || widest < 0.023, "{widest}");
    }
}

/// Soft-score and match p-values of a fixed extractor answer for random messages.
fn p_values_of_random_messages(logits: &[f64], trials: u32) -> (Vec<f64>, Vec<f64>) {
    let rng = &mut prf(6).stream(Purpose::OtherKeys, 0);
    let null = SoftScoreNull::new(logits).expect("finite");
    let bits: Vec<bool> = logits.iter().map(|o| *o > 0.0).collect();
    let read = Message::from_bits(&bits).expect("32 bits");
    let trial = |_| {
        let message = Message::random(read.num_bits(), rng).expect("32 bits");
        let matches = read.num_bits() - message.hamming(&read).expect("equal lengths");
        (null.p_value(&message).expect("equal lengths"), match_p_value(matches, read.num_bits()))
    };
    (0..trials).map(trial).unzip()
}
