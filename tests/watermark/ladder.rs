//! Embeddings that climb from little to more, and end in time.

use guard4d_engine::render::OffsetBases;
use guard4d_engine::scene::gaussians::{CHANNELS, SH_FLOATS};
use guard4d_engine::watermark::embed::{
    Aim, EmbedConfig, Embedded, Embedding, Estimate, Ladder, Left, Profile, Rung, StepReport,
};
use guard4d_engine::watermark::evidence::ExtractorMode;
use guard4d_kernels::Device;

use crate::support::gpu::device;
use crate::support::owner::{BITS, Owner};

/// Steps in which the mark settles when the last rung is left.
const SETTLING: usize = 25;

/// Three rungs of two or four steps each, with a look after every second step; none is left before.
fn three_rungs(owner: &Owner) -> EmbedConfig {
    let first = Rung { bases: OffsetBases::Dc, reach: 0.5, views: 2, steps: 2 };
    let second = Rung { reach: 1.0, views: 3, ..first };
    let third = Rung { bases: OffsetBases::All, steps: 4, ..second };
    let ladder = Ladder {
        rungs: vec![first, second, third],
        aim: Aim { p_value: 0.0, proven: 1.0, accuracy: 1.0 },
        every: 2,
        patience: 100,
        held_out: 1,
    };
    let small =
        EmbedConfig { responses: BITS as usize, size_px: (32, 32), steps: 60, views: 3, ..owner.config.clone() };
    // A mark that eight bits do not show is never enough.
    EmbedConfig { ladder: Some(ladder), bases: OffsetBases::All, ..small.with_target(80.0) }
}

fn prepare<'a>(device: &'a Device, owner: &'a Owner, config: &EmbedConfig) -> Embedding<'a> {
    Embedding::prepare(owner.subject(device), config.clone()).expect("prepares")
}

/// Takes all steps.
fn train(mut embedding: Embedding<'_>) -> (Vec<StepReport>, Embedded) {
    let reports = std::iter::from_fn(|| embedding.step().expect("steps")).collect();
    (reports, embedding.finish().expect("finishes"))
}

fn bits(embedded: &Embedded) -> Vec<u32> {
    embedded.sh_coeffs.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn each_rung_goes_on_from_the_one_below_also_after_a_break() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = three_rungs(&owner);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |step: usize| folder.path().join(step.to_string());
    let mut embedding = prepare(&gpu, &owner, &config);
    assert_eq!((embedding.training_shots().count(), embedding.held_out_shots().count()), (2, 1), "clips at first");
    let (mut reports, mut clips) = (Vec::new(), Vec::new());
    for step in 1..=5 {
        reports.push(embedding.step().expect("steps").expect("there are more"));
        clips.push(embedding.training_shots().count());
        embedding.save(&path(step)).expect("saves");
    }
    assert_eq!(clips, [2, 3, 3, 3, 3], "clips after each step");
    let (rest, unbroken) = train(embedding);
    reports.extend(rest);
    let asked: Vec<_> = reports.iter().take(8).map(|report| report.held_out.is_some()).collect();
    assert_eq!(asked, [false, true].repeat(4), "looks");
    let steps: Vec<_> = unbroken.rungs.iter().map(|rung| (rung.steps, rung.views, rung.left)).collect();
    assert_eq!(steps, [(2, 2, Left::Steps), (2, 3, Left::Steps), (4, 3, Left::Steps)], "{:?}", unbroken.rungs);
    assert_eq!((unbroken.steps, reports.len()), (8 + SETTLING, 8 + SETTLING), "steps");
    let all = owner.model.gaussians.len();
    let [few, every, rest] = [0, 1, 2].map(|rung| unbroken.rungs[rung]);
    assert!(few.splats > 0 && 2 * few.splats < all, "half of the light is of {} of {all} splats", few.splats);
    assert_eq!((few.offsets, every.splats, every.offsets), (CHANNELS * few.splats, all, CHANNELS * all));
    assert_eq!(rest.offsets, CHANNELS * 16 * all, "of third degree");
    for (rung, name) in unbroken.rungs.iter().zip(["train on rung 1", "train on rung 2", "train on rung 3"]) {
        assert!(unbroken.seconds[name] > 0.0, "{name}: {:?}", unbroken.seconds);
        assert!(unbroken.looks.contains(&rung.look), "its last look: {rung:?}");
    }
    let moved = |k: usize| {
        let rows =
            unbroken.sh_coeffs.chunks_exact(SH_FLOATS).zip(owner.model.gaussians.sh_coeffs.chunks_exact(SH_FLOATS));
        rows.filter(|(with, without)| with[k] != without[k]).count()
    };
    assert!(moved(0) > few.splats && moved(CHANNELS) > 0, "{} and {} coefficients moved", moved(0), moved(CHANNELS));

    // On each rung, and just after it was reached.
    for step in [1, 2, 3, 4, 5] {
        let mut resumed = prepare(&gpu, &owner, &config);
        resumed.restore(&path(step)).expect("restores");
        let (again, resumed) = train(resumed);
        assert_eq!(again, reports[step..], "what the steps after step {step} see");
        assert!(bits(&unbroken) == bits(&resumed), "the same mark with and without a break after step {step}");
        assert_eq!((&unbroken.rungs, &unbroken.looks), (&resumed.rungs, &resumed.looks), "and the same story");
    }
}

#[test]
fn a_mark_that_is_enough_ends_on_the_rung_where_it_is() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let mut config = three_rungs(&owner).with_target(30.0);
    let ladder = config.ladder.as_mut().expect("there is one");
    // Any mark will do.
    (ladder.aim, ladder.rungs[0].steps) = (Aim { p_value: 1.0, proven: 0.0, accuracy: 0.0 }, 4);
    let (reports, embedded) = train(prepare(&gpu, &owner, &config));
    let [rung] = embedded.rungs[..] else { panic!("one rung: {:?}", embedded.rungs) };
    assert_eq!((rung.left, rung.steps), (Left::Enough, 4), "at its end: {rung:?}");
    assert_eq!((embedded.steps, reports.len(), embedded.looks.len()), (4, 4, 1), "nothing is left to settle");

    // The last rung ends at any look, while the rates are high.
    let ladder = config.ladder.as_mut().expect("there is one");
    ladder.rungs = vec![Rung { steps: 60, ..ladder.rungs[0] }];
    let (reports, embedded) = train(prepare(&gpu, &owner, &config));
    let [rung] = embedded.rungs[..] else { panic!("one rung: {:?}", embedded.rungs) };
    assert_eq!((rung.left, rung.steps), (Left::Enough, 2), "at its first look: {rung:?}");
    assert_eq!((embedded.steps, reports.len()), (rung.steps + SETTLING, rung.steps + SETTLING), "steps");

    // Steps that end before a rung does are all that there are.
    config.steps = 1;
    let (_, embedded) = train(prepare(&gpu, &owner, &config));
    let [rung] = embedded.rungs[..] else { panic!("one rung: {:?}", embedded.rungs) };
    assert_eq!((rung.left, rung.steps, rung.look.step, embedded.steps), (Left::Steps, 1, 1, 1));
}

#[test]
fn an_estimate_of_a_ladder_is_the_most_that_it_takes() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = three_rungs(&owner);
    let estimate = Estimate::of(owner.subject(&gpu), &config).expect("estimates");
    assert_eq!(estimate.clips, 4, "three to train on, one held out: {estimate:?}");
    assert!(estimate.train_seconds > 0.0 && estimate.train_seconds.is_finite(), "{estimate:?}");
}

#[test]
fn the_ladder_of_a_profile_keeps_extractor_and_bases() {
    let plain = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind);
    let said = serde_json::to_value(&plain).expect("JSON");
    assert!(said["ladder"].is_null(), "as before there was a choice: {said}");
    for bases in [OffsetBases::Dc, OffsetBases::All] {
        let config =
            EmbedConfig { bases, ..plain.clone() }.climbing(Aim { p_value: 1e-6, proven: 1.0, accuracy: 0.0 }, 48);
        config.validate_for(48).expect("sensible");
        assert_eq!((config.mode, config.bases, config.responses), (plain.mode, bases, 48), "{config:?}");
        let ladder = config.ladder.expect("there is one");
        let [first, second, last] = ladder.rungs[..] else { panic!("three rungs: {ladder:?}") };
        assert!(
            first.reach < 1.0 && first.views < second.views && first.steps < second.steps,
            "less at first: {first:?}"
        );
        assert_eq!(first.steps + second.steps + last.steps, plain.steps, "all steps: {ladder:?}");
        assert_eq!(first.bases, bases, "of the same coefficients");
        assert_eq!((last.reach, last.views, last.bases), (1.0, plain.views, bases), "all at last");
    }
    let joint = EmbedConfig::new(Profile::Draft, ExtractorMode::Joint);
    assert!(joint.tmsd_held > 0.0, "R is held at first");
    let climbing = joint.climbing(Aim { p_value: 1e-3, proven: 1.0, accuracy: 0.0 }, 16);
    assert_eq!(climbing.tmsd_held, 0.0, "but not where training can end before its turn");
    let mut bad = plain.climbing(Aim { p_value: 1e-3, proven: 1.0, accuracy: 0.9 }, 16);
    bad.ladder.as_mut().expect("there is one").rungs.reverse();
    let refused = bad.validate().expect_err("downwards").to_string();
    assert!(refused.contains("ladder") && refused.contains("the one below"), "{refused}");
}
