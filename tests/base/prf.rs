//! Keyed streams: frozen values, separation, secrecy of the secret.

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose, standard_normal, uniform_below, uniform_unit};

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

/// First two words of a stream; a word is redrawn only if it is the largest, once in 2^32.
fn head(prf: &Prf, purpose: Purpose, index: u64) -> [u32; 2] {
    let rng = &mut prf.stream(purpose, index);
    [uniform_below(rng, u32::MAX), uniform_below(rng, u32::MAX)]
}

/// Frozen: keys that users hold must derive the same streams in every version and on every platform.
/// The values come from an independent implementation (Python, `blake3` 1.0 and ChaCha20 by hand).
#[test]
fn streams_are_frozen() {
    assert_eq!(head(&prf(7), Purpose::TokenTable, 0), [1_927_229_184, 1_090_102_237]);
    assert_eq!(head(&prf(7), Purpose::Message, 16), [569_512_971, 3_127_265_120]);
    let id = "50d07e525e488f89ed93a374286fdee143c8bd650f84f47356d829636cbee8c6";
    assert_eq!(prf(7).key_id().to_string(), id);
}

#[test]
fn streams_differ_by_key_purpose_and_index() {
    let purposes = [
        Purpose::TokenTable,
        Purpose::DecoderInit,
        Purpose::DecoderTraining,
        Purpose::Message,
        Purpose::PayloadPad,
        Purpose::TmsdInit,
        Purpose::Views,
        Purpose::HeldOutViews,
        Purpose::Responses,
        Purpose::Calibration,
        Purpose::Embedding,
        Purpose::ControlNoise,
        Purpose::OtherKeys,
        Purpose::SwapMessage,
        Purpose::MessageMac,
        Purpose::KeyId,
    ];
    let mut words = Vec::new();
    for key in [1, 2] {
        for purpose in purposes {
            words.extend([0, 1, u64::MAX].map(|index| head(&prf(key), purpose, index)));
        }
    }
    let num_streams = words.len();
    words.sort_unstable();
    words.dedup();
    assert_eq!(words.len(), num_streams);
}

#[test]
fn secrets_are_drawn_and_never_printed() {
    let secret = MasterSecret::generate().expect("a random source");
    assert_ne!(secret, MasterSecret::generate().expect("a random source"));
    let hidden = format!("{:?} {:?}", MasterSecret::from_bytes([0xab; 32]), prf(0xab));
    assert!(!hidden.to_lowercase().contains("abab") && !hidden.contains("171, 171"), "{hidden}");
}

#[test]
fn bounded_draws_are_uniform_and_in_range() {
    let rng = &mut prf(3).stream(Purpose::Embedding, 0);
    let mut counts = [0_u32; 7];
    for _ in 0..70_000 {
        counts[uniform_below(rng, 7) as usize] += 1;
    }
    // Standard deviation sqrt(70000 * 6/49) = 92.6; five of them.
    assert!(counts.iter().all(|c| c.abs_diff(10_000) < 463), "{counts:?}");
    assert_eq!(uniform_below(rng, 1), 0);
    assert!((0..100).all(|_| uniform_below(rng, u32::MAX) < u32::MAX), "the largest bound");
}

#[test]
fn unit_and_normal_draws_have_their_moments() {
    let rng = &mut prf(4).stream(Purpose::Embedding, 0);
    let count = 40_000;
    let unit: Vec<f64> = (0..count).map(|_| uniform_unit(rng)).collect();
    assert!(unit.iter().all(|u| (0.0..1.0).contains(u)), "range");
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / f64::from(count);
    // Five standard errors: 0.289/200, 1/200, 1.414/200 and 9.8/200.
    assert!((mean(&mut unit.iter().copied()) - 0.5).abs() < 0.0073, "mean of uniform");
    let normal: Vec<f64> = (0..count).map(|_| standard_normal(rng)).collect();
    assert!(normal.iter().all(|x| x.is_finite()), "finite");
    assert!(mean(&mut normal.iter().copied()).abs() < 0.025, "mean");
    assert!((mean(&mut normal.iter().map(|x| x * x)) - 1.0).abs() < 0.036, "variance");
    assert!((mean(&mut normal.iter().map(|x| x.powi(4))) - 3.0).abs() < 0.25, "fourth moment");
}
