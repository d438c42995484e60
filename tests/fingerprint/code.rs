//! Chips to the bit, what coalitions leave, and what scores mean by chance.

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose, standard_normal};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::code::{Bias, Code, CopyKey, Position};
use guard4d_kernels::reference::code::copy_score::chacha8;

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

fn copy(number: u64) -> CopyKey {
    CopyKey::new(&prf(1), Digest::of(b"an asset"), number)
}

#[test]
fn chips_are_the_ciphers_to_the_bit() {
    let code = Code::draw(&prf(1), 1001);
    for number in [0, 1, u64::MAX] {
        let key = copy(number);
        let words = (0u32..).flat_map(|block| chacha8(&key.words(), block));
        let halves = words.flat_map(|word| [word & 0xffff, word >> 16]);
        let chip = |(half, position): (u32, &Position)| match position {
            Position::OfCopy(bias) => half < u32::from(bias.steps()),
            Position::Shared(is_plus) => *is_plus,
        };
        let want: Vec<bool> = halves.zip(code.positions()).map(chip).collect();
        assert_eq!(code.chips(&key).collect::<Vec<_>>(), want, "copy {number}");
    }
    let chips = |key: &CopyKey| code.chips(key).collect::<Vec<_>>();
    let elsewhere =
        [CopyKey::new(&prf(2), Digest::of(b"an asset"), 1), CopyKey::new(&prf(1), Digest::of(b"another"), 1), copy(2)];
    for other in elsewhere {
        let alike = chips(&copy(1)).iter().zip(chips(&other)).filter(|(a, b)| **a == *b).count();
        // Two copies agree at p² + (1−p)² of their own positions, 0.699 on average, and at one of 16 that is shared,
        // for which another key has half: 0.70 or 0.72, 1.4 % from one code to the next.
        assert!((640..790).contains(&alike), "{alike} of 1001");
    }
    assert_eq!(format!("{:?}", copy(1)), "CopyKey(hidden)");
}

/// How often each of the nodes is drawn.
fn shares(code: &Code) -> [f64; 3] {
    let count = |node| code.positions().iter().filter(|position| **position == Position::OfCopy(node)).count() as f64;
    let all: f64 = Bias::NODES.map(count).iter().sum();
    Bias::NODES.map(|node| count(node) / all)
}

#[test]
fn a_code_has_the_shares_and_symbols_that_its_proofs_want() {
    let shares = shares(&Code::draw(&prf(3), 1_000_000));
    // Four deviations of a share of a million.
    for (share, want) in shares.into_iter().zip([0.332_013, 0.335_974, 0.332_013]) {
        assert!((share - want).abs() < 0.0019, "{share} for {want}");
    }
    let mut mean_square = 0.0;
    for (bias, share) in Bias::NODES.into_iter().zip(shares) {
        let (p, [plus, minus], [up, down]) = (bias.probability(), bias.symbols(), bias.offsets());
        assert!((p * plus + (1.0 - p) * minus).abs() < 1e-12, "mean 0");
        assert!((p * plus * plus + (1.0 - p) * minus * minus - 1.0).abs() < 1e-12, "variance 1");
        assert!((p * up + (1.0 - p) * down).abs() < 1e-12, "all copies together are the original");
        mean_square += share * (p * up * up + (1.0 - p) * down * down);
    }
    // That of plain signs, as far as the shares above are the right ones.
    assert!((mean_square - 1.0).abs() < 2e-3, "{mean_square}");
}

/// The mean score, of all together, that `k` copies leave at a position where what they put there is +1 if `rule` says
/// so for the number of them that have +1 (and is what they have where they all agree).
fn coalition(k: u32, shares: [f64; 3], rule: u32) -> f64 {
    let mut sum = 0.0;
    for (bias, share) in Bias::NODES.into_iter().zip(shares) {
        let (p, [plus, minus]) = (bias.probability(), bias.symbols());
        let mut ways = 1.0;
        for x in 0..=k {
            let mixed = if x == k || (x > 0 && rule >> (x - 1) & 1 == 1) { 1.0 } else { -1.0 };
            let likely = ways * p.powi(x as i32) * (1.0 - p).powi((k - x) as i32);
            sum += share * likely * mixed * (f64::from(x) * plus + f64::from(k - x) * minus);
            ways *= f64::from(k - x) / f64::from(x + 1);
        }
    }
    sum
}

#[test]
fn up_to_six_copies_leave_the_same_trace_by_whatever_rule() {
    let shares = [0.332_013_2, 0.335_973_7, 0.332_013_2];
    for k in 1..=6 {
        for rule in 0..1 << (k - 1) {
            // 2/Z = 0.7559; biases are rounded to 2^-16.
            let left = coalition(k, shares, rule);
            assert!((left - 0.7559).abs() < 1e-3, "{k} copies, rule {rule:b}: {left}");
        }
    }
    // Seven do not, by the rule that takes what fewer of them have.
    let minority = coalition(7, shares, 0b00_0111);
    assert!((minority - 0.7559).abs() > 1e-2, "{minority}");
}

/// Evidence with some positions that outweigh the others by far.
fn evidence(seed: u8, positions: usize) -> Vec<f64> {
    let mut rng = prf(seed).stream(Purpose::ControlNoise, 0);
    (0..positions).map(|_| standard_normal(&mut rng)).map(|v| v * v * v).collect()
}

#[test]
fn scores_of_copies_that_were_never_made_are_what_chance_says() {
    let (positions, copies) = (1000, 20_000u32);
    let code = Code::draw(&prf(4), positions);
    let found = evidence(5, positions);
    let chance = code.by_chance(&found).expect("one for each");
    // What all copies share tells none apart.
    let own = code.positions().iter().zip(&found).filter(|(position, _)| matches!(position, Position::OfCopy(_)));
    let length = own.map(|(_, c)| c * c).sum::<f64>().sqrt();
    assert!(chance.mean().abs() < 1e-9 * length);
    assert!((chance.deviation() / length - 1.0).abs() < 1e-9);
    let scores: Vec<f64> = (0..copies).map(|j| code.score(&found, &copy(u64::from(j))).expect("scored")).collect();
    let count = f64::from(copies);
    let mean = scores.iter().sum::<f64>() / count / length;
    let variance = scores.iter().map(|s| s * s).sum::<f64>() / count / length.powi(2);
    // Four deviations of each: 1/√n, and √(2/n) and a little for what outweighs the others.
    assert!(mean.abs() < 0.0283, "{mean}");
    assert!((variance - 1.0).abs() < 0.045, "{variance}");
    for t in [2.0, 3.0, 3.5] {
        let reached = f64::from(scores.iter().filter(|s| **s >= t * length).count() as u32) / count;
        let told = chance.log_tail(t * length);
        assert!(told.bound.exp() > reached, "{t}: {} below {reached}", told.bound.exp());
        // Four deviations of a count.
        let room = 4.0 * (told.estimate.exp() / count).sqrt() + 1.0 / count;
        assert!((told.estimate.exp() - reached).abs() < room, "{t}: {} for {reached}", told.estimate.exp());
    }
}

#[test]
fn the_copy_that_was_filmed_stands_out_and_no_other() {
    let positions = 4000;
    let code = Code::draw(&prf(6), positions);
    let noise = evidence(7, positions);
    // A mark at a fifth of the noise.
    let found: Vec<f64> = code.offsets(&copy(17)).zip(&noise).map(|(m, n)| 0.8 * m + n).collect();
    let chance = code.by_chance(&found).expect("one for each");
    let bound = |number| chance.log_tail(code.score(&found, &copy(number)).expect("scored")).bound;
    assert!(bound(17) < -30.0, "{}", bound(17));
    let others: Vec<u64> = (0..200).filter(|number| *number != 17 && bound(*number) < -9.2).collect();
    assert_eq!(others, [0; 0], "each of them by chance once in 10,000");
    // The chips that all copies share say that it is a copy at all.
    let log_p = |evidence: &[f64]| {
        let shared = code.shared_score(evidence).expect("one for each");
        shared.chance.log_tail(shared.score).bound
    };
    // 250 of them, at a fifth of the noise: 2 to 5 deviations.
    assert!(log_p(&found) < -2.0, "{}", log_p(&found));
    assert!(log_p(&noise) > -2.0, "{}", log_p(&noise));
    // Without the mark nobody does.
    let chance = code.by_chance(&noise).expect("one for each");
    assert!(chance.log_tail(code.score(&noise, &copy(17)).expect("scored")).bound > -9.2);
    let wrong = code.score(&noise[1..], &copy(17));
    assert!(matches!(wrong, Err(EngineError::Usage { .. })), "{wrong:?}");
}
