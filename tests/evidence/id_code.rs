//! Codes of ids: their distances, soft decoding against exhaustive comparison, recovery rates, and honest p-values.

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose, standard_normal, uniform_below, uniform_unit};
use guard4d_engine::evidence::id_code::{IdBits, IdCode};
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::evidence::statistics::{binomial_tail, match_p_value, required_matches};
use rand_chacha::ChaCha20Rng;

/// Standard deviations that a fixed seed may be off: chance alone gives 6e-7 of draws more.
const SIGMAS: f64 = 5.0;

fn prf() -> Prf {
    Prf::new(&MasterSecret::from_bytes([3; 32]))
}

fn code(id_bits: IdBits, num_bits: u32) -> IdCode {
    IdCode::new(id_bits, num_bits).expect("a length in the table")
}

fn lengths(id_bits: IdBits) -> impl Iterator<Item = u32> {
    (8..=128).step_by(8).filter(move |&num_bits| num_bits > id_bits.count())
}

/// Number of codewords of each weight `[L + 1]`.
fn weights(code: &IdCode) -> Vec<u32> {
    let mut weights = vec![0; code.num_bits() as usize + 1];
    for id in 0..code.id_bits().num_ids() {
        weights[code.codeword(id).expect("an id").value().count_ones() as usize] += 1;
    }
    weights
}

#[test]
fn stated_distances_are_the_true_ones() {
    for id_bits in IdBits::ALL {
        let mut distances = Vec::new();
        for num_bits in lengths(id_bits) {
            let code = code(id_bits, num_bits);
            let weights = weights(&code);
            assert_eq!(weights[0], 1, "{id_bits} in {num_bits}: only one codeword is zero");
            // In a linear code the smallest distance is the smallest weight.
            let smallest = (1..).zip(&weights[1..]).find(|(_, count)| **count > 0).expect("others are not zero").0;
            assert_eq!(code.distance(), smallest, "{id_bits} in {num_bits}");
            distances.push(smallest);
        }
        assert!(distances.is_sorted(), "longer keys keep ids further apart: {distances:?}");
    }
    // The extended Golay code's distance, which is the greatest that 24 bits allow.
    assert_eq!(code(IdBits::Twelve, 24).distance(), 8);
}

#[test]
fn codes_are_linear_and_systematic() {
    let rng = &mut prf().stream(Purpose::OtherKeys, 0);
    for id_bits in IdBits::ALL {
        for num_bits in lengths(id_bits) {
            let code = code(id_bits, num_bits);
            let word = |id: u32| code.codeword(id).expect("an id").value();
            for _ in 0..50 {
                let (a, b) = (uniform_below(rng, id_bits.num_ids()), uniform_below(rng, id_bits.num_ids()));
                assert_eq!(word(a) ^ word(b), word(a ^ b), "{id_bits} in {num_bits}: linear");
                assert_eq!(word(a) >> (num_bits - id_bits.count()), u128::from(a), "the id comes first");
            }
            assert!(code.codeword(id_bits.num_ids()).is_err(), "an id too large");
        }
    }
}

#[test]
fn lengths_without_a_code_are_refused() {
    for (id_bits, num_bits) in [(12, 0), (12, 8), (12, 12), (12, 20), (12, 136), (16, 16), (16, 15), (16, u32::MAX)] {
        let id_bits = IdBits::parse(&format!("id:{id_bits}")).expect("a kind of id");
        assert_eq!(IdCode::new(id_bits, num_bits).expect_err("refused").exit_code(), 2, "{id_bits} in {num_bits}");
    }
    for text in ["id:13", "id:", "12", "id:12 ", ""] {
        assert_eq!(IdBits::parse(text), None, "{text}");
    }
}

#[test]
fn ids_become_uniform_messages_and_come_back() {
    for id_bits in IdBits::ALL {
        for num_bits in lengths(id_bits) {
            let text = format!("{id_bits}:1234");
            let payload = Payload::parse(&text, num_bits).expect("an id");
            assert_eq!(payload.id_bits(), Some(id_bits));
            let message = payload.message(&prf()).expect("a length");
            let code = code(id_bits, num_bits);
            let codeword = code.codeword(1234).expect("an id");
            assert_ne!(message, codeword, "the pad hides it");
            assert_eq!(Payload::from_message(&message, &prf()).expect("a length"), Payload::Chosen(codeword));
            let logits: Vec<f64> = message.bits().map(|bit| if bit { 0.5 } else { -0.5 }).collect();
            let found = code.decode(&logits, &code.pad(&prf()).expect("a length")).expect("finite");
            assert_eq!(found.id, 1234, "{text} in {num_bits}");
            // Every bit adds 0.5 to the best; the distance to the next takes off twice that for each bit of it.
            let gap = f64::from(code.distance()) / f64::from(num_bits);
            assert!((found.score - 0.5).abs() < 1e-12 && found.margin() > gap - 1e-12, "sums of halves: {found:?}");
        }
    }
}

fn signed(message: &Message, logits: &[f64]) -> f64 {
    message.bits().zip(logits).map(|(bit, o)| if bit { *o } else { -o }).sum::<f64>() / logits.len() as f64
}

#[test]
fn the_transform_finds_what_comparing_with_every_message_finds() {
    let rng = &mut prf().stream(Purpose::ControlNoise, 0);
    for (id_bits, num_bits) in
        [(IdBits::Twelve, 16), (IdBits::Twelve, 48), (IdBits::Sixteen, 24), (IdBits::Sixteen, 72)]
    {
        let code = code(id_bits, num_bits);
        let pad = code.pad(&prf()).expect("a length");
        let logits: Vec<f64> = (0..num_bits).map(|_| standard_normal(rng)).collect();
        let found = code.decode(&logits, &pad).expect("finite");
        let mut scores: Vec<(f64, u32)> =
            (0..id_bits.num_ids()).map(|id| (signed(&code.message(id, &pad).expect("an id"), &logits), id)).collect();
        scores.sort_by(|a, b| b.0.total_cmp(&a.0));
        assert_eq!((found.id, found.runner_up), (scores[0].1, scores[1].1), "{id_bits} in {num_bits}");
        // Two sums of at most 72 numbers of order 1 in another order.
        assert!((found.score - scores[0].0).abs() < 1e-12, "{found:?}");
        assert!((found.runner_up_score - scores[1].0).abs() < 1e-12, "{found:?}");
    }
}

#[test]
fn what_cannot_be_decoded_is_refused() {
    let code = code(IdBits::Twelve, 32);
    let pad = code.pad(&prf()).expect("a length");
    for bad in [f64::NAN, f64::INFINITY] {
        let mut logits = vec![1.0; 32];
        logits[7] = bad;
        assert_eq!(code.decode(&logits, &pad).expect_err("no number").exit_code(), 70);
    }
    assert_eq!(code.decode(&[1.0; 31], &pad).expect_err("too few").exit_code(), 2);
    assert_eq!(code.decode(&[1.0; 32], &Message::from_value(0, 24).expect("24")).expect_err("pad").exit_code(), 2);
    let silent = code.decode(&[0.0; 32], &pad).expect("finite");
    assert_eq!((silent.id, silent.runner_up, silent.margin()), (0, 1, 0.0), "a clip that says nothing prefers none");
    let reading = Reading::from_logits(&[0.0; 32], 32).expect("finite");
    assert_eq!(code.read(&reading, &prf()).expect("32 bits").1.soft_score, 1.0, "and proves nothing");
}

/// Signal over noise at which a bit with Gaussian noise is wrong with probability `rate`: Q⁻¹(rate).
fn reliability(rate: f64) -> f64 {
    let table = [(0.05, 1.644_854), (0.10, 1.281_552), (0.15, 1.036_433), (0.20, 0.841_621)];
    table.into_iter().find(|(listed, _)| *listed == rate).expect("a listed rate").1
}

/// Upper tail of the normal distribution, at most 1e-7 above the true one at any `x`.
fn normal_tail_bound(x: f64) -> f64 {
    // Trapezoids over a convex integrand lie above it; from 12 on there is less than 2e-33 left.
    const STEP: f64 = 1e-3;
    let density = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
    let steps = ((12.0 - x) / STEP).ceil().max(0.0) as u32;
    let at = |i: u32| density(x + STEP * f64::from(i));
    (0..steps).map(|i| 0.5 * STEP * (at(i) + at(i + 1))).sum::<f64>() + 2e-33
}

/// Chance that the majority of the copies of every bit of an id is right, ties going either way: id bit j has the
/// message bits j, j + 12, j + 24, …
fn majority_rate(num_bits: u32, wrong: f64) -> f64 {
    let copies = |j: u32| (num_bits - j).div_ceil(12);
    let bit = |n: u32| {
        let right = |least: u32| binomial_tail(least, n, 1.0 - wrong);
        let tie = if n.is_multiple_of(2) { right(n / 2) - right(n / 2 + 1) } else { 0.0 };
        right(n / 2 + 1) + 0.5 * tie
    };
    (0..12).map(|j| bit(copies(j))).product()
}

/// One try of plain repetition and majority with the same noise: whether all 12 bits come out.
fn majority_recovers(noisy: &[f64], rng: &mut ChaCha20Rng) -> bool {
    (0..12).all(|j| {
        // Every bit sent is 1; a tie is a coin.
        let votes: i32 = noisy.iter().skip(j).step_by(12).map(|o| if *o > 0.0 { 1 } else { -1 }).sum();
        votes > 0 || votes == 0 && uniform_unit(rng) < 0.5
    })
}

/// Recovery of `id:12` in 32 and 48 bits against repeating each bit and taking majorities, at the same noise.
#[test]
fn soft_decoding_recovers_ids_that_majorities_lose() {
    const TRIES: u32 = 1000;
    let mut shown = Vec::new();
    for num_bits in [32, 48] {
        let code = code(IdBits::Twelve, num_bits);
        let pad = code.pad(&prf()).expect("a length");
        let weights = weights(&code);
        for rate in [0.05, 0.10, 0.15, 0.20] {
            let signal = reliability(rate);
            let rng = &mut prf().stream(Purpose::ControlNoise, u64::from(num_bits) << 8 | (100.0 * rate) as u64);
            let (mut soft, mut majority, mut wrong_bits) = (0, 0, 0);
            for _ in 0..TRIES {
                let id = uniform_below(rng, 4096);
                let noisy: Vec<f64> = (0..num_bits).map(|_| signal + standard_normal(rng)).collect();
                let message = code.message(id, &pad).expect("an id");
                let logits: Vec<f64> = message.bits().zip(&noisy).map(|(bit, o)| if bit { *o } else { -o }).collect();
                soft += u32::from(code.decode(&logits, &pad).expect("finite").id == id);
                majority += u32::from(majority_recovers(&noisy, rng));
                wrong_bits += noisy.iter().filter(|o| **o <= 0.0).count();
            }
            let tries = f64::from(TRIES);
            let slack = |p: f64, n: f64| SIGMAS * (p * (1.0 - p) / n).sqrt();
            let (soft, majority) = (f64::from(soft) / tries, f64::from(majority) / tries);
            let bits = tries * f64::from(num_bits);
            assert!((wrong_bits as f64 / bits - rate).abs() < slack(rate, bits), "the noise is as asked");
            let expected = majority_rate(num_bits, rate);
            assert!((majority - expected).abs() < slack(expected, tries), "{majority} majority, {expected} expected");
            // Another codeword wins over w differing bits with probability Q(√w · signal); the union bound adds them.
            let lost: f64 = (1..)
                .zip(&weights[1..])
                .map(|(w, &n)| f64::from(n) * normal_tail_bound(f64::from(w).sqrt() * signal))
                .sum();
            let floor = (1.0 - lost).max(0.0);
            let least = floor - slack(floor, tries) - SIGMAS / tries;
            assert!(soft >= least, "{num_bits} bits at {rate}: {soft}, at least {least}");
            // The difference of two measured rates is off by less than the sum of both slacks.
            assert!(
                soft > majority + slack(soft, tries) + slack(expected, tries),
                "{num_bits} bits at {rate}: {soft} against {majority}"
            );
            shown.push(format!("{num_bits} bits, {:.0} % wrong: soft {soft:.3}, majority {majority:.3}", 100.0 * rate));
        }
    }
    println!("{}", shown.join("\n"));
}

/// Hard readings have an exact rate while spheres around codewords do not overlap, and the searched p-value is it.
#[test]
fn searched_p_values_are_exact_for_few_wrong_bits() {
    const TRIES: u32 = 20_000;
    let code = code(IdBits::Twelve, 32);
    let pad = code.pad(&prf()).expect("a length");
    let least = 29;
    assert!(2 * (32 - least) < code.distance(), "no word is this near to two codewords");
    let rate = 4096.0 * match_p_value(least, 32);
    let rng = &mut prf().stream(Purpose::ControlNoise, 1);
    let mut near = 0;
    for _ in 0..TRIES {
        let read = Message::random(32, rng).expect("32 bits");
        let logits: Vec<f32> = read.bits().map(|bit| if bit { 1.0 } else { -1.0 }).collect();
        let reading = Reading::from_logits(&logits, 32).expect("finite");
        let f64s: Vec<f64> = logits.iter().map(|&o| f64::from(o)).collect();
        let id = code.decode(&f64s, &pad).expect("finite").id;
        near += u32::from(reading.matches(&code.message(id, &pad).expect("an id")).expect("32 bits") >= least);
    }
    let (got, slack) = (f64::from(near) / f64::from(TRIES), SIGMAS * (rate / f64::from(TRIES)).sqrt());
    assert!((got - rate).abs() < slack, "{got} of random readings, {rate} stated");
}

/// 100,000 clips that hold nothing, read for whichever of 4096 ids fits best.
#[test]
fn random_readings_are_accepted_no_more_often_than_stated() {
    const TRIES: u32 = 100_000;
    let code = code(IdBits::Twelve, 48);
    let pad = code.pad(&prf()).expect("a length");
    let rng = &mut prf().stream(Purpose::ControlNoise, 2);
    let [strict, lax] = [1e-6, 1e-2].map(|fpr| required_matches(48, fpr / 4096.0).expect("48 bits reach it"));
    let (mut accepted, mut often, mut soft_often) = (0, 0, 0);
    const SOFT: u32 = 300;
    for number in 0..TRIES {
        let logits: Vec<f32> = (0..48).map(|_| standard_normal(rng) as f32).collect();
        let reading = Reading::from_logits(&logits, 48).expect("finite");
        let id = code.decode(reading.mean_logits(), &pad).expect("finite").id;
        let matches = reading.matches(&code.message(id, &pad).expect("an id")).expect("48 bits");
        accepted += u32::from(matches >= strict);
        often += u32::from(matches >= lax);
        if number < SOFT {
            let (_, p) = code.read(&reading, &prf()).expect("48 bits");
            assert!(p.soft_score > 1e-6 && p.matches > 1e-6, "{p:?}");
            soft_often += u32::from(p.soft_score <= 0.1);
        }
    }
    assert_eq!(accepted, 0, "0.1 were expected of 100,000 at most");
    let most = |rate: f64, n: u32| rate * f64::from(n) + SIGMAS * (rate * f64::from(n)).sqrt();
    assert!(f64::from(often) <= most(1e-2, TRIES), "{often} at a stated rate of at most 1e-2");
    assert!(f64::from(soft_often) <= most(0.1, SOFT), "{soft_often} of {SOFT} at a stated rate of at most 0.1");
    assert!(soft_often > 0, "the bound on soft scores is not empty");
}
