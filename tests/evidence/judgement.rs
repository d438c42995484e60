//! Verdicts: what is said, and what keeps it from being said.

use std::collections::BTreeMap;
use std::sync::Mutex;

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose, standard_normal};
use guard4d_engine::evidence::claim::Claim;
use guard4d_engine::evidence::control::{ChanceDeviation, Control, ControlKind, ControlState};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::judgement::{Evidence, PStatement, Verdict, judge};
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::negative_controls::Pool;
use guard4d_engine::evidence::other_keys::{NUM_OTHER_KEYS, OtherKeys};
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::evidence::reason::Reason;
use guard4d_engine::evidence::thresholds::{DecisionStatistic, Thresholds};

fn prf() -> Prf {
    Prf::new(&MasterSecret::from_bytes([5; 32]))
}

fn owner(num_bits: u32) -> Message {
    Message::random(num_bits, &mut prf().stream(Purpose::Message, 0)).expect("a length that messages have")
}

/// A clip of `frames` frames that says `message` with the first `wrong` bits flipped.
fn says(message: &Message, wrong: usize, frames: usize) -> Reading {
    let logit = |(i, bit): (usize, bool)| if bit == (i >= wrong) { 1.5 } else { -1.5 };
    let row: Vec<f32> = message.bits().enumerate().map(logit).collect();
    Reading::from_logits(&row.repeat(frames), message.num_bits()).expect("finite")
}

/// A clip that says nothing about any message of ours.
fn noise(num_bits: u32, frames: u32, index: u64) -> Reading {
    let rng = &mut prf().stream(Purpose::ControlNoise, index);
    let logits: Vec<f32> = (0..num_bits * frames).map(|_| standard_normal(rng) as f32).collect();
    Reading::from_logits(&logits, num_bits).expect("finite")
}

/// Our other keys at some clip, derived once per length: hundreds of judgements share them.
fn other_keys(num_bits: u32) -> &'static OtherKeys {
    static KEYS: Mutex<BTreeMap<u32, &'static OtherKeys>> = Mutex::new(BTreeMap::new());
    let derive = || {
        let keys = OtherKeys::derive(&prf(), noise(num_bits, 8, 999).mean_logits()).expect("finite");
        &*Box::leak(Box::new(keys))
    };
    KEYS.lock().expect("no test fails in here").entry(num_bits).or_insert_with(derive)
}

fn verify(
    message: &Message,
    mode: ExtractorMode,
    reading: &Reading,
    controls: &[Control],
    rule: &Thresholds,
) -> Evidence {
    let other_keys = other_keys(message.num_bits());
    let claim =
        Claim { message: *message, searched: 1, mode, reading, other_keys, side_px: 400, controls, objections: &[] };
    judge(&claim, rule).expect("lengths and thresholds fit")
}

fn control(kind: ControlKind, reading: Reading, message: Message) -> Control {
    Control { kind, name: format!("{kind} 1"), reading, message }
}

fn has(evidence: &Evidence, wanted: fn(&Reason) -> bool) -> bool {
    evidence.reasons.iter().any(wanted)
}

#[test]
fn a_clear_mark_is_present_and_an_unmarked_clip_absent() {
    let message = owner(32);
    let rule = Thresholds::default();
    let marked = verify(&message, ExtractorMode::None, &says(&message, 2, 8), &[], &rule);
    assert_eq!((marked.verdict, marked.matches, marked.matches_needed), (Verdict::Present, 30, Some(30)));
    let PStatement::Exact { matches, soft_score } = marked.p_value else { panic!("identity is message-blind") };
    assert!((matches - 1.231_674_104_928_970_3e-7).abs() < 1e-20, "{matches}");
    assert_eq!(matches, soft_score, "equal logits");
    assert_eq!(marked.panel.not_run.len(), 3);
    assert_eq!(marked.verdict.exit_code(), 0);

    let nearly = verify(&message, ExtractorMode::None, &says(&message, 3, 8), &[], &rule);
    assert_eq!(nearly.verdict, Verdict::Inconclusive, "29 of 32 misses 1e-6");
    assert!(has(&nearly, |r| matches!(r, Reason::Weak { .. })), "{:?}", nearly.reasons);
    assert_eq!(nearly.verdict.exit_code(), 4);

    let other = verify(&message, ExtractorMode::Pretrained, &noise(32, 8, 0), &[], &rule);
    assert_eq!(other.verdict, Verdict::Absent);
    assert_eq!(other.verdict.exit_code(), 1);
}

#[test]
fn sixteen_bits_cannot_reach_one_in_a_million() {
    let message = owner(16);
    let perfect = says(&message, 0, 8);
    let evidence = verify(&message, ExtractorMode::None, &perfect, &[], &Thresholds::default());
    assert_eq!((evidence.verdict, evidence.matches_needed), (Verdict::Inconclusive, None));
    assert!(has(&evidence, |r| matches!(r, Reason::CannotReach { .. })), "{:?}", evidence.reasons);
    let rule = Thresholds { fpr: 1e-3, ..Thresholds::default() };
    assert_eq!(verify(&message, ExtractorMode::None, &perfect, &[], &rule).verdict, Verdict::Present);
    let many = Thresholds { num_claims: 1000, ..rule };
    let evidence = verify(&message, ExtractorMode::None, &perfect, &[], &many);
    assert_eq!((evidence.verdict, evidence.matches_needed), (Verdict::Inconclusive, None), "1000 keys were tried");
}

#[test]
fn few_or_small_frames_are_inconclusive_either_way() {
    let message = owner(48);
    let rule = Thresholds::default();
    for reading in [says(&message, 0, 1), noise(48, 1, 3)] {
        let evidence = verify(&message, ExtractorMode::None, &reading, &[], &rule);
        assert_eq!(evidence.verdict, Verdict::Inconclusive);
        assert!(has(&evidence, |r| matches!(r, Reason::TooFewFrames { got: 1, needed: 8 })), "{:?}", evidence.reasons);
    }
    let reading = says(&message, 0, 8);
    let other_keys = other_keys(48);
    let claim = Claim {
        message,
        searched: 1,
        mode: ExtractorMode::None,
        reading: &reading,
        other_keys,
        side_px: 32,
        controls: &[],
        objections: &[],
    };
    let evidence = judge(&claim, &rule).expect("lengths fit");
    assert_eq!(evidence.verdict, Verdict::Inconclusive);
    assert!(has(&evidence, |r| matches!(r, Reason::FramesTooSmall { .. })), "{:?}", evidence.reasons);
}

#[test]
fn a_firing_control_forbids_present_on_either_side_of_chance() {
    let message = owner(32);
    let rule = Thresholds::default();
    let suspect = says(&message, 0, 8);
    let quiet = control(ControlKind::CleanRender, noise(32, 8, 1), message);
    let evidence = verify(&message, ExtractorMode::Blind, &suspect, &[quiet], &rule);
    assert_eq!(evidence.verdict, Verdict::Present, "{:?}", evidence.reasons);
    for reciting in [says(&message, 2, 8), says(&message, 30, 8)] {
        let leaks = control(ControlKind::CleanRender, reciting, message);
        let evidence = verify(&message, ExtractorMode::Blind, &suspect, &[leaks], &rule);
        assert_eq!(evidence.verdict, Verdict::Inconclusive);
        let told: Vec<_> = evidence.reasons.iter().map(ToString::to_string).collect();
        assert!(told.iter().any(|t| t.contains("clean render") && t.contains("not at chance")), "{told:?}");
    }
}

/// With a thousand clips no single 16-bit reading is improbable enough; half of them reciting is.
#[test]
fn many_reciting_clips_fire_together() {
    let message = owner(16);
    let rule = Thresholds { fpr: 1e-3, ..Thresholds::default() };
    let suspect = says(&message, 0, 8);
    let clip = |i: u64| if i.is_multiple_of(2) { says(&message, 0, 8) } else { noise(16, 8, i) };
    let clips =
        |count| -> Vec<Control> { (0..count).map(|i| control(ControlKind::UnrelatedClip, clip(i), message)).collect() };
    let evidence = verify(&message, ExtractorMode::Blind, &suspect, &clips(1000), &rule);
    assert!(evidence.panel.supplied.iter().all(|c| c.chance_deviation.state == ControlState::Quiet), "alone");
    assert_eq!(evidence.verdict, Verdict::Inconclusive);
    let told: Vec<_> = evidence.reasons.iter().map(ToString::to_string).collect();
    assert!(told.iter().any(|t| t.contains("all films without a mark") && t.contains("of 16000 bits")), "{told:?}");
    let noises = [noise(16, 8, 1), noise(16, 8, 3), noise(16, 8, 5)];
    let quiet = noises.map(|reading| control(ControlKind::UnrelatedClip, reading, message));
    assert_eq!(verify(&message, ExtractorMode::Blind, &suspect, &quiet, &rule).verdict, Verdict::Present);
}

/// Six views of an original that each say most of the message, and none of them so much that it would fire alone.
#[test]
fn clean_renders_that_lean_towards_the_message_fire_together() {
    let message = owner(16);
    let rule = Thresholds { fpr: 1e-3, ..Thresholds::default() };
    let suspect = says(&message, 0, 8);
    let view = |wrong: u128| says(&Message::from_value(message.value() ^ wrong, 16).expect("16 bits"), 0, 8);
    // 13, 14, 14, 13, 14 and 10 of 16 bits, wrong in another place each.
    let wrong = [0b111, 0b11 << 3, 0b11 << 5, 0b111 << 7, 0b11 << 10, 0b11_1111 << 10];
    let views = wrong.map(|wrong| control(ControlKind::CleanRender, view(wrong), message));
    let evidence = verify(&message, ExtractorMode::Blind, &suspect, &views, &rule);
    assert!(evidence.panel.supplied.iter().all(|c| c.chance_deviation.state == ControlState::Quiet), "alone");
    let pool = evidence.panel.pools[0];
    assert_eq!((pool.pool, pool.num_readings, pool.matches, pool.num_bits), (Pool::CleanRenders, 6, 78, 96));
    // No bit is wrong in most views: one message of 2^16 agrees with all votes, and one with none.
    assert_eq!((pool.p_value, pool.state), (2.0 / 65536.0, ControlState::Fires));
    assert_eq!(evidence.verdict, Verdict::Inconclusive, "{:?}", evidence.reasons);
    // The same word in all views is one coincidence and not six: it is judged as one reading would be.
    let alike = [0; 6].map(|_| control(ControlKind::CleanRender, view(0b111), message));
    let evidence = verify(&message, ExtractorMode::Blind, &suspect, &alike, &rule);
    let p: f64 = (0..=3u32).map(|wrong| [1.0, 16.0, 120.0, 560.0][wrong as usize]).sum::<f64>() / 65536.0;
    assert!((evidence.panel.pools[0].p_value - 2.0 * p).abs() < 1e-15, "{:?}", evidence.panel.pools[0]);
}

/// What is not committed, or read through a CLIP that anybody could have made, is never present.
#[test]
fn objections_forbid_present_and_leave_absent() {
    let message = owner(32);
    let (rule, other_keys) = (Thresholds::default(), other_keys(32));
    for objection in
        [Reason::NotCommitted { schema: "guard4d.receipt/2".to_owned() }, Reason::UnknownClip { clip: "00".repeat(32) }]
    {
        for (reading, verdict) in [(says(&message, 0, 8), Verdict::Inconclusive), (noise(32, 8, 1), Verdict::Absent)] {
            let claim = Claim {
                message,
                searched: 1,
                mode: ExtractorMode::Blind,
                reading: &reading,
                other_keys,
                side_px: 400,
                controls: &[],
                objections: std::slice::from_ref(&objection),
            };
            let evidence = judge(&claim, &rule).expect("lengths fit");
            assert_eq!(evidence.verdict, verdict, "{:?}", evidence.reasons);
            assert!(evidence.reasons.contains(&objection), "{:?}", evidence.reasons);
            let is_exact = matches!(evidence.p_value, PStatement::Exact { .. });
            assert_eq!(is_exact, matches!(objection, Reason::UnknownClip { .. }), "{:?}", evidence.p_value);
        }
    }
}

/// Clean renders of a sound extractor forbid "present" no more often than promised.
#[test]
fn controls_fire_by_chance_as_rarely_as_promised() {
    let rule = Thresholds { fpr: 1e-3, control_level: 0.05, ..Thresholds::default() };
    let codeword = Message::from_value(0x00ff_f00f, 32).expect("32 bits");
    let rng = &mut prf().stream(Purpose::OtherKeys, 78);
    let fired = (0..400).filter(|_| {
        let message = Message::random(32, rng).expect("32 bits");
        let clean = [0; 3].map(|_| control(ControlKind::CleanRender, says(&codeword, 0, 8), message));
        !verify(&message, ExtractorMode::Blind, &says(&message, 0, 8), &clean, &rule).panel.firing().is_empty()
    });
    // At most 20 of 400 expected, standard deviation 4.4; five of them.
    let fired = fired.count();
    assert!(fired <= 42, "{fired} of 400");
}

#[test]
fn the_anti_message_is_noticed_and_is_not_present() {
    let message = owner(32);
    let evidence = verify(&message, ExtractorMode::None, &says(&message, 32, 8), &[], &Thresholds::default());
    assert_eq!(evidence.verdict, Verdict::Absent);
    assert_eq!(evidence.panel.inverted.chance_deviation.state, ControlState::Fires);
    assert_eq!(evidence.panel.inverted.chance_deviation.matches, 32);
    let straight = verify(&message, ExtractorMode::None, &says(&message, 0, 8), &[], &Thresholds::default());
    assert_eq!(straight.panel.inverted.chance_deviation.state, ControlState::Quiet);
}

/// Best match of the messages that the other keys of an owner would embed, derived here once more.
fn best_of_others(reading: &Reading, owner: &Prf) -> u32 {
    let others = (0..NUM_OTHER_KEYS).map(|index| {
        let secret = owner.mac(Purpose::OtherKeys, &index.to_le_bytes());
        let other = Prf::new(&MasterSecret::from_bytes(*secret.as_bytes()));
        let own = Payload::Random(32).message(&other).expect("32 bits");
        reading.matches(&own).expect("32 bits")
    });
    others.max().expect("there are some")
}

#[test]
fn other_keys_rank_the_claim() {
    let message = owner(32);
    let reading = says(&message, 0, 8);
    let panel = verify(&message, ExtractorMode::None, &reading, &[], &Thresholds::default()).panel;
    for others in [&panel.other_messages, &panel.other_readings] {
        assert_eq!((others.num_keys, others.as_good, others.false_positives), (1000, 0, 0));
        assert!((others.rank_p_value - 1.0 / 1001.0).abs() < 1e-15, "{others:?}");
        // The best of 1000 chance matches of 32 bits: 29 has p = 1.3e-6, so 1000 draws reach it once in 800 runs.
        assert!((20..29).contains(&others.most_matches), "{others:?}");
    }
    assert_eq!(panel.other_messages.most_matches, best_of_others(&reading, &prf()), "keys follow from the owner's");
}

/// Unlike the message of a other key, its reading depends on the clip.
#[test]
fn other_keys_read_by_their_own_calibration() {
    let message = owner(16);
    let reading = says(&message, 0, 8);
    let judged = |coordinates: &[f64]| {
        let other_keys = &OtherKeys::derive(&prf(), coordinates).expect("finite");
        let claim = Claim {
            message,
            searched: 1,
            mode: ExtractorMode::None,
            reading: &reading,
            other_keys,
            side_px: 400,
            controls: &[],
            objections: &[],
        };
        judge(&claim, &Thresholds::default()).expect("lengths fit").panel
    };
    let coordinates = reading.mean_logits();
    let scaled: Vec<f64> = coordinates.iter().map(|z| 0.01 * z).collect();
    assert_eq!(judged(coordinates), judged(&scaled), "the strength of a mark is no part of a reading");
    let opposite: Vec<f64> = coordinates.iter().map(|z| -z).collect();
    let best = |coordinates: &[f64]| judged(coordinates).other_readings.most_matches;
    // Of 1000 chance matches of 16 bits the best are 13 or more but in 2 of 100,000 runs.
    let bests = [best(coordinates), best(&opposite), best(noise(16, 8, 200).mean_logits())];
    assert!(bests.iter().all(|best| (13..=16).contains(best)), "{bests:?}");
}

#[test]
fn a_joint_extractor_gets_no_exact_p_value() {
    let message = owner(32);
    let rule = Thresholds { fpr: 1e-2, ..Thresholds::default() };
    let suspect = says(&message, 0, 8);
    let alone = verify(&message, ExtractorMode::Joint, &suspect, &[], &rule);
    assert_eq!(alone.verdict, Verdict::Inconclusive, "no unrelated clips, no statement");
    assert_eq!(alone.p_value, PStatement::Empirical { false_positives: 0, num_clips: 0, bound: 1.0 });
    assert!(has(&alone, |r| matches!(r, Reason::EmpiricalOnly { num_clips: 0 })), "{:?}", alone.reasons);

    let unrelated = |count: u64| -> Vec<Control> {
        (0..count).map(|i| control(ControlKind::UnrelatedClip, noise(32, 8, 100 + i), message)).collect()
    };
    let enough = verify(&message, ExtractorMode::Joint, &suspect, &unrelated(99), &rule);
    assert_eq!(enough.verdict, Verdict::Inconclusive, "a trained network proves nothing: {:?}", enough.reasons);
    assert!(has(&enough, |r| matches!(r, Reason::Passes { .. })), "the bound is told: {:?}", enough.reasons);
    let few = verify(&message, ExtractorMode::Joint, &suspect, &unrelated(20), &rule);
    assert_eq!(few.verdict, Verdict::Inconclusive, "20 clips do not support 1e-2");

    let mut reciting = unrelated(98);
    reciting.push(control(ControlKind::UnrelatedClip, says(&message, 0, 8), message));
    let evidence = verify(&message, ExtractorMode::Joint, &suspect, &reciting, &rule);
    assert_ne!(evidence.verdict, Verdict::Present, "the extractor says it of any clip");
    assert_eq!(evidence.p_value, PStatement::Empirical { false_positives: 1, num_clips: 99, bound: 0.02 });
    let json = serde_json::to_string(&evidence).expect("finite figures");
    assert!(json.contains("\"kind\":\"empirical\"") && !json.contains("soft_score\":"), "{json}");
}

#[test]
fn soft_score_uses_what_the_bits_are_worth() {
    let message = owner(32);
    // Eight wrong bits whisper, the others are sure.
    let signed = |(i, bit): (usize, bool)| if i < 8 { 0.05 } else { 2.0 } * if bit == (i >= 8) { 1.0 } else { -1.0 };
    let row: Vec<f32> = message.bits().enumerate().map(signed).collect();
    let reading = Reading::from_logits(&row.repeat(8), 32).expect("finite");
    let by_score = Thresholds::default();
    let by_count = Thresholds { statistic: DecisionStatistic::Matches, ..by_score };
    assert_ne!(verify(&message, ExtractorMode::None, &reading, &[], &by_count).verdict, Verdict::Present);
    assert_eq!(verify(&message, ExtractorMode::None, &reading, &[], &by_score).verdict, Verdict::Present);
}

#[test]
fn logits_are_averaged_before_the_threshold() {
    let message = Message::from_value(0b10, 2).expect("two bits");
    // Two frames whisper the wrong bit, one is sure of the right one.
    let reading = Reading::from_logits(&[-0.1, -1.0, -0.1, -1.0, 3.0, 1.0], 2).expect("finite");
    assert_eq!(reading.decoded(), message);
    assert_eq!(reading.num_frames(), 3);
    let spread = reading.frame_accuracy(&message).expect("equal lengths");
    assert_eq!((spread.min, spread.max, spread.mean), (0.5, 0.5, 0.5));
    assert!((reading.bit_consistency() - 2.0 / 3.0).abs() < 1e-15, "two of three agree on both bits");
    let margins = reading.margins(&message).expect("equal lengths");
    // Sums of f32 constants in f64.
    assert!((margins[0] - 2.8 / 3.0).abs() < 1e-7 && (margins[1] - 1.0 / 3.0).abs() < 1e-7, "{margins:?}");
}

#[test]
fn poison_and_wrong_lengths_are_errors() {
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let error = Reading::from_logits(&[0.0, 1.0, 2.0, poison], 2).expect_err("poison");
        assert_eq!(error.exit_code(), 70);
        assert!(error.to_string().contains("bit 1 in frame 1"), "{error}");
    }
    for (logits, num_bits) in [(&[] as &[f32], 2), (&[1.0], 0), (&[1.0, 2.0, 3.0], 2), (&[0.0; 129], 129)] {
        assert_eq!(Reading::from_logits(logits, num_bits).expect_err("length").exit_code(), 2);
    }
    let reading = noise(16, 8, 0);
    let mut claim = Claim {
        message: owner(32),
        searched: 1,
        mode: ExtractorMode::None,
        reading: &reading,
        other_keys: other_keys(16),
        side_px: 400,
        controls: &[],
        objections: &[],
    };
    let refused = |claim: &Claim<'_>| judge(claim, &Thresholds::default()).expect_err("refused").exit_code();
    assert_eq!(refused(&claim), 2, "a message of another length than the clip's");
    claim.message = owner(16);
    claim.other_keys = other_keys(32);
    assert_eq!(refused(&claim), 2, "other keys of another length");
    (claim.other_keys, claim.searched) = (other_keys(16), 0);
    assert_eq!(refused(&claim), 2, "chosen from nothing");
    claim.searched = 1;
    judge(&claim, &Thresholds::default()).expect("nothing else is wrong");
    for poison in [f64::NAN, f64::INFINITY] {
        let refused = OtherKeys::derive(&prf(), &[1.0, poison]).expect_err("coordinates that are no numbers");
        assert_eq!(refused.exit_code(), 70, "{refused}");
    }
    assert_eq!(OtherKeys::derive(&prf(), &[]).expect_err("no bits").exit_code(), 2);
}

#[test]
fn thresholds_that_are_no_rule_are_refused() {
    let base = Thresholds::default();
    let bad = [
        Thresholds { fpr: 0.0, ..base },
        Thresholds { fpr: f64::NAN, ..base },
        Thresholds { absent_above: 1e-9, ..base },
        Thresholds { absent_above: f64::NAN, ..base },
        Thresholds { control_level: 1.0, ..base },
        Thresholds { num_claims: 0, ..base },
        Thresholds { min_frames: 0, ..base },
    ];
    assert!(base.validate().is_ok(), "the default");
    for rule in bad {
        assert_eq!(rule.validate().expect_err("no rule").exit_code(), 2, "{rule:?}");
    }
}

#[test]
fn leaks_are_measured_on_both_sides() {
    let chance_deviation = |matches| ChanceDeviation::measure(matches, 16, 0.99).expect("a confidence");
    for (matches, state) in [
        (0, ControlState::Fires),
        (2, ControlState::Fires),
        (3, ControlState::Quiet),
        (13, ControlState::Quiet),
        (14, ControlState::Fires),
    ] {
        assert_eq!(chance_deviation(matches).state, state, "{matches}");
    }
    assert_eq!(chance_deviation(0).deviation, 0.5);
    assert_eq!(chance_deviation(8).deviation, 0.0);
}

/// Unmarked clips read by an extractor that recites one codeword: over owners, "present" is never said.
#[test]
fn reciting_extractors_accuse_no_one() {
    let rule = Thresholds { fpr: 1e-3, ..Thresholds::default() };
    let codeword = Message::from_value(0xffff_0fff, 32).expect("32 bits");
    let suspect = says(&codeword, 0, 8);
    let rng = &mut prf().stream(Purpose::OtherKeys, 77);
    let present = (0..300).filter(|_| {
        let message = Message::random(32, rng).expect("32 bits");
        verify(&message, ExtractorMode::None, &suspect, &[], &rule).verdict == Verdict::Present
    });
    // Expected 0.16 of 300 (p of 26/32 is 5.4e-4); more than 3 has probability 3e-5.
    assert!(present.count() <= 3, "false accusations");
}

#[test]
fn a_message_found_by_search_pays_for_the_search() {
    let (message, reading) = (owner(48), says(&owner(48), 4, 8));
    let rule = Thresholds::default();
    let fixed = Claim {
        message,
        searched: 1,
        mode: ExtractorMode::Blind,
        reading: &reading,
        other_keys: other_keys(48),
        side_px: 400,
        controls: &[],
        objections: &[],
    };
    let alone = judge(&fixed, &rule).expect("fits");
    let PStatement::Exact { matches: p, .. } = alone.p_value else { panic!("fixed beforehand") };
    let found = judge(&Claim { searched: 4096, ..fixed.clone() }, &rule).expect("fits");
    let PStatement::Searched(searched) = found.p_value else { panic!("searched: {:?}", found.p_value) };
    // 44 of 48 have 7.6e-10 alone: 3.1e-6 as the best of 4096.
    assert_eq!((searched.matches, searched.searched), (4096.0 * p, 4096));
    assert_eq!((alone.verdict, found.verdict), (Verdict::Present, Verdict::Inconclusive));
    assert_eq!((alone.matches_needed, found.matches_needed), (Some(41), Some(45)));
    assert!(has(&found, |r| matches!(r, Reason::Weak { .. })), "{:?}", found.reasons);
    let joint = Claim { mode: ExtractorMode::Joint, searched: 4096, ..fixed };
    let joint = judge(&joint, &Thresholds { fpr: 0.01, ..rule }).expect("fits");
    assert_eq!(joint.p_value, PStatement::Empirical { false_positives: 0, num_clips: 0, bound: 1.0 });
    assert_eq!(joint.verdict, Verdict::Inconclusive, "no number of clips pays for the search");
    let whole = verify(&message, ExtractorMode::Blind, &says(&message, 0, 8), &[], &rule);
    assert!(whole.exact && !alone.exact, "all bits, or not");
}
