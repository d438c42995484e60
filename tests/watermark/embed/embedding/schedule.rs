//! Embeddings that go from little to more, and end in time.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::render::OffsetBases;
use guard4d_engine::scene::gaussians::{CHANNELS, SH_FLOATS};
use guard4d_engine::watermark::embed::{
    AdaptiveSchedule, Aim, EmbedConfig, Embedded, Embedding, Estimate, Phase, Profile, StepReport, StopReason,
};
use guard4d_kernels::Device;

use crate::support::gpu::device;
use crate::support::owner::{BITS, Owner};

/// Steps in which the mark settles when the last phase is left.
const SETTLING: usize = 25;

/// Three phases of two or four steps each, with a look after every second step; none is left before.
fn three_phases(owner: &Owner) -> EmbedConfig {
    let first = Phase { bases: OffsetBases::Dc, visibility_share: 0.5, clips: 2, steps: 2 };
    let second = Phase { visibility_share: 1.0, clips: 3, ..first };
    let third = Phase { bases: OffsetBases::All, steps: 4, ..second };
    let schedule = AdaptiveSchedule {
        phases: vec![first, second, third],
        aim: Aim { p_value: 0.0, proven: 1.0, accuracy: 1.0 },
        every: 2,
        patience: 100,
        held_out: 1,
    };
    let small = owner.config.clone().with(|c| {
        c.extractor.calibration_mut().expect("fitted").probes = BITS as usize;
        c.views.size_px = (32, 32);
        c.optimiser.steps = 60;
        c.views.clips = 3;
    });
    // A mark that eight bits do not show is never enough.
    small.with_target(80.0).with(|c| {
        c.schedule = Some(schedule);
        c.fidelity.bases = OffsetBases::All;
    })
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
fn each_phase_goes_on_from_the_one_before_also_after_a_break() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = three_phases(&owner);
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
    let steps: Vec<_> = unbroken.phases.iter().map(|phase| (phase.steps, phase.clips, phase.stop_reason)).collect();
    assert_eq!(
        steps,
        [(2, 2, StopReason::Steps), (2, 3, StopReason::Steps), (4, 3, StopReason::Steps)],
        "{:?}",
        unbroken.phases
    );
    assert_eq!((unbroken.steps, reports.len()), (8 + SETTLING, 8 + SETTLING), "steps");
    let all = owner.model.gaussians.len();
    let [few, every, rest] = [0, 1, 2].map(|phase| unbroken.phases[phase]);
    assert!(few.splats > 0 && 2 * few.splats < all, "half of the light is of {} of {all} splats", few.splats);
    assert_eq!((few.offsets, every.splats, every.offsets), (CHANNELS * few.splats, all, CHANNELS * all));
    assert_eq!(rest.offsets, CHANNELS * 16 * all, "of third degree");
    for (phase, name) in unbroken.phases.iter().zip(["train in phase 1", "train in phase 2", "train in phase 3"]) {
        assert!(unbroken.seconds[name] > 0.0, "{name}: {:?}", unbroken.seconds);
        assert!(unbroken.evaluations.contains(&phase.evaluation), "its last look: {phase:?}");
    }
    let moved = |k: usize| {
        let rows =
            unbroken.sh_coeffs.chunks_exact(SH_FLOATS).zip(owner.model.gaussians.sh_coeffs.chunks_exact(SH_FLOATS));
        rows.filter(|(with, without)| with[k] != without[k]).count()
    };
    assert!(moved(0) > few.splats && moved(CHANNELS) > 0, "{} and {} coefficients moved", moved(0), moved(CHANNELS));

    // On each phase, and just after it was reached.
    for step in [1, 2, 3, 4, 5] {
        let mut resumed = prepare(&gpu, &owner, &config);
        resumed.restore(&path(step)).expect("restores");
        let (again, resumed) = train(resumed);
        assert_eq!(again, reports[step..], "what the steps after step {step} see");
        assert!(bits(&unbroken) == bits(&resumed), "the same mark with and without a break after step {step}");
        assert_eq!(
            (&unbroken.phases, &unbroken.evaluations),
            (&resumed.phases, &resumed.evaluations),
            "and the same story"
        );
    }
}

#[test]
fn a_mark_that_is_enough_ends_in_the_phase_where_it_is() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let mut config = three_phases(&owner).with_target(30.0);
    let schedule = config.schedule.as_mut().expect("there is one");
    // Any mark will do.
    (schedule.aim, schedule.phases[0].steps) = (Aim { p_value: 1.0, proven: 0.0, accuracy: 0.0 }, 4);
    let (reports, embedded) = train(prepare(&gpu, &owner, &config));
    let [phase] = embedded.phases[..] else { panic!("one phase: {:?}", embedded.phases) };
    assert_eq!((phase.stop_reason, phase.steps), (StopReason::Enough, 4), "at its end: {phase:?}");
    assert_eq!((embedded.steps, reports.len(), embedded.evaluations.len()), (4, 4, 1), "nothing is left to settle");

    // The last phase ends at any look, while the rates are high.
    let schedule = config.schedule.as_mut().expect("there is one");
    schedule.phases = vec![Phase { steps: 60, ..schedule.phases[0] }];
    let (reports, embedded) = train(prepare(&gpu, &owner, &config));
    let [phase] = embedded.phases[..] else { panic!("one phase: {:?}", embedded.phases) };
    assert_eq!((phase.stop_reason, phase.steps), (StopReason::Enough, 2), "at its first look: {phase:?}");
    assert_eq!((embedded.steps, reports.len()), (phase.steps + SETTLING, phase.steps + SETTLING), "steps");

    // Steps that end before a phase does are all that there are.
    config.optimiser.steps = 1;
    let (_, embedded) = train(prepare(&gpu, &owner, &config));
    let [phase] = embedded.phases[..] else { panic!("one phase: {:?}", embedded.phases) };
    assert_eq!((phase.stop_reason, phase.steps, phase.evaluation.step, embedded.steps), (StopReason::Steps, 1, 1, 1));
}

#[test]
fn an_estimate_of_a_schedule_is_the_most_that_it_takes() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = three_phases(&owner);
    let estimate = Estimate::of(owner.subject(&gpu), &config).expect("estimates");
    assert_eq!(estimate.clips, 4, "three to train on, one held out: {estimate:?}");
    assert!(estimate.train_seconds > 0.0 && estimate.train_seconds.is_finite(), "{estimate:?}");
}

#[test]
fn the_schedule_of_a_profile_keeps_extractor_and_bases() {
    let plain = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind);
    let said = serde_json::to_value(&plain).expect("JSON");
    assert!(said["schedule"].is_null(), "as before there was a choice: {said}");
    for bases in [OffsetBases::Dc, OffsetBases::All] {
        let config = plain
            .clone()
            .with(|c| c.fidelity.bases = bases)
            .adaptive(Aim { p_value: 1e-6, proven: 1.0, accuracy: 0.0 }, 48);
        config.validate_for(48).expect("sensible");
        assert_eq!(
            (config.mode(), config.fidelity.bases, config.extractor.probes()),
            (plain.mode(), bases, 48),
            "{config:?}"
        );
        let schedule = config.schedule.expect("there is one");
        let [first, second, last] = schedule.phases[..] else { panic!("three phases: {schedule:?}") };
        assert!(
            first.visibility_share < 1.0 && first.clips < second.clips && first.steps < second.steps,
            "less at first: {first:?}"
        );
        assert_eq!(first.steps + second.steps + last.steps, plain.optimiser.steps, "all steps: {schedule:?}");
        assert_eq!(first.bases, bases, "of the same coefficients");
        assert_eq!((last.visibility_share, last.clips, last.bases), (1.0, plain.views.clips, bases), "all at last");
    }
    let joint = EmbedConfig::new(Profile::Draft, ExtractorMode::Joint);
    assert!(joint.extractor.joint().expect("it is").tmsd_held > 0.0, "R is held at first");
    let adaptive = joint.adaptive(Aim { p_value: 1e-3, proven: 1.0, accuracy: 0.0 }, 16);
    assert_eq!(
        adaptive.extractor.joint().expect("it is").tmsd_held,
        0.0,
        "but not where training can end before its turn"
    );
    let mut bad = plain.adaptive(Aim { p_value: 1e-3, proven: 1.0, accuracy: 0.9 }, 16);
    bad.schedule.as_mut().expect("there is one").phases.reverse();
    let refused = bad.validate().expect_err("downwards").to_string();
    assert!(refused.contains("schedule") && refused.contains("the one before"), "{refused}");
}
