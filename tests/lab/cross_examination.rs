//! Frozen extractors, where the message lives, and what a step costs.

use guard4d_engine::evidence::control::{ControlKind, ControlState};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::judgement::PStatement;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::media::{ReadOptions, read_clip};
use guard4d_engine::release::evaluate::{HeldOut, chance_deviation};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, Start, Subject};
use guard4d_engine::watermark::key::owner_key::Key;
use guard4d_engine::watermark::step_part::StepPart;
use guard4d_lab::cross_examination::{
    OtherOwner, OtherScene, Witnesses, cross_examine, read_other_owners, read_swap, swap_message,
};

use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::owner::{BITS, Owner, cameras, key_file_of};

fn joint(owner: &Owner) -> EmbedConfig {
    // Every loss, so that every kernel of a step runs.
    owner.config_of(ExtractorMode::Joint).with(|c| {
        c.optimiser.steps = 2;
        c.objective.lambda_recon = 1.0;
        c.objective.lambda_offset = 1.0;
    })
}

fn run(mut embedding: Embedding<'_>) -> Embedded {
    while embedding.step().expect("steps").is_some() {}
    embedding.finish().expect("finishes")
}

fn shoot(gpu: &Gpu, owner: &Owner, embedded: &Embedded) -> HeldOut {
    HeldOut::render(gpu, &owner.model, &embedded.sh_coeffs, &cameras()).expect("films")
}

/// Every pass of a step belongs to a part, and every part takes time.
fn assert_parts(embedded: &Embedded) {
    let parts = &embedded.part_seconds;
    assert_eq!(parts[&StepPart::Other], 0.0, "strays: {parts:?}");
    for part in StepPart::ALL.into_iter().filter(|p| *p != StepPart::Other) {
        assert!(parts[&part] > 0.0, "{} takes time", part.name());
    }
    let (sum, whole) = (parts.values().sum::<f64>(), embedded.device_seconds.values().sum::<f64>());
    // The same terms in another order.
    assert!((sum - whole).abs() <= 1e-9 * whole, "{sum} of {whole} s");
}

#[test]
fn a_frozen_extractor_stays_as_it_is_and_reads_the_second_copy() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let subject = owner.subject(&gpu);
    let embedding = Embedding::prepare(subject, joint(&owner)).expect("prepares");
    let fitted = embedding.fitted().clone();
    let first = run(embedding);
    assert_parts(&first);
    assert!(fitted.tmsd != first.extractor.tmsd, "joint trains R");
    let (before, after) = (&fitted.calibration, &first.extractor.calibration);
    assert_eq!((&before.directions, &before.mean_image), (&after.directions, &after.mean_image));
    assert!(before.mean_logits != after.mean_logits, "R has moved the zero");

    let message = swap_message(&owner.message, &owner.key);
    assert_eq!(owner.message.hamming(&message).expect("equal lengths"), BITS / 2);
    let other = Subject { message: &message, ..subject };
    let frozen = Start::Frozen(&first.extractor);
    let second = run(Embedding::prepare_with(other, joint(&owner), frozen).expect("prepares"));
    assert_eq!(second.extractor, first.extractor, "nothing of it is trained");
    assert!(second.sh_coeffs != first.sh_coeffs, "another message, another mark");
    let parts = &second.part_seconds;
    assert!(parts[&StepPart::Tmsd] > 0.0 && parts[&StepPart::Other] == 0.0, "{parts:?}");

    let swap = read_swap(&subject, &first.extractor, &shoot(&gpu, &owner, &second), &message).expect("reads");
    assert_eq!([swap.second.num_bits, swap.first.num_bits], [BITS; 2], "one clip");
    // The messages agree in half of the bits, so a bit that is read agrees with exactly one where they differ.
    assert_eq!((swap.second.matches + swap.first.matches) % 2, 0, "{swap:?}");

    let blind = Embedding::prepare_with(subject, owner.config.clone(), frozen);
    let refused = blind.err().expect("a joint extractor cannot pass for a blind one");
    assert_eq!(refused.exit_code(), 2, "{refused}");
}

#[test]
fn a_mark_of_twice_the_strength_costs_six_decibels() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let embedded = run(Embedding::prepare(owner.subject(&gpu), joint(&owner)).expect("prepares"));
    let clean = &owner.model.gaussians.sh_coeffs;
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(&embedded.with_strength(clean, 0.0)) == bits(clean), "no mark at all");
    let expected: Vec<_> = clean.iter().zip(&embedded.sh_coeffs).map(|(c, m)| 2.0 * m - c).collect();
    // Rounding of a difference, a product and a sum of coefficients below 8.
    assert_close(&embedded.with_strength(clean, 2.0), &expected, 32.0 * f32::EPSILON, 0.0);
    let own = -10.0 * embedded.mse.log10();
    assert!(own.is_finite() && own > 20.0, "{own} dB");
    let quarter = 10.0 * 4f32.log10();
    for (psnr, strength) in [(own, 1.0), (own - quarter, 2.0), (own + quarter, 0.5)] {
        // Rounding of a logarithm of about 5 and a power of ten, times ln 10 / 2 of its exponent.
        assert_close(&[embedded.strength_for(psnr)], &[strength], 0.0, 1e-5);
    }
}

#[test]
fn joint_gains_nothing_from_what_the_control_shows_too() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = joint(&owner);
    let mut embedding = Embedding::prepare(owner.subject(&gpu), config.clone()).expect("prepares");
    let report = embedding.step().expect("steps").expect("there is a first step");
    // Before the first update the marked clip is the clean one, which is the first control: every logit differs by
    // exactly 0 from the control's, whatever R and the decoder say of them, and misses the margin by all of it.
    let nothing = config.objective.margin.exp().ln_1p();
    // A sum of 128 equal terms in f32, divided by 128.
    assert_close(&[report.message], &[nothing], 1e-4, 0.0);
}

#[test]
fn a_cross_examination_hears_every_witness() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let subject = owner.subject(&gpu);
    for config in [owner.config.clone(), joint(&owner)] {
        let embedding = Embedding::prepare(subject, config.clone()).expect("prepares");
        let fitted = embedding.fitted().clone();
        let embedded = run(embedding);
        let held_out = shoot(&gpu, &owner, &embedded);
        let scenes = [OtherScene { name: "other", clips: &held_out.clean }];
        let witnesses = Witnesses { scenes: &scenes, other_key: &owner.key, untrained: Some(&fitted) };
        let said = cross_examine(&subject, &embedded.extractor, &held_out, &witnesses).expect("reads");
        assert!(said.evidence.panel.not_run.is_empty(), "all kinds of control: {:?}", said.evidence.panel.not_run);
        let kinds: Vec<_> = said.evidence.panel.supplied.iter().map(|c| c.kind).collect();
        assert_eq!(kinds, [ControlKind::CleanRender, ControlKind::UnrelatedClip, ControlKind::OtherKey]);
        assert_eq!(said.evidence.num_frames, 2);
        let exact = matches!(said.evidence.p_value, PStatement::Exact { .. });
        assert_eq!(exact, config.mode() != ExtractorMode::Joint, "joint has no p-value");
        // One clip: the whole reading is the clip's, and the other key is the owner's.
        assert_eq!(said.wrong_key.matches, said.evidence.matches);
        let evaluation =
            held_out.evaluate(&gpu, &owner.clip, &owner.key, &embedded.extractor, &owner.message).expect("reads");
        assert_eq!(vec![said.evidence.matches], evaluation.matches);
        let elsewhere = said.other_scenes.expect("there is another scene");
        assert_eq!(elsewhere, evaluation.clean_leak, "the other scene is the clean one");
        let untrained = said.untrained.expect("it was given");
        assert!(config.mode() == ExtractorMode::Joint || untrained == said.wrong_key, "blind is never trained");
    }
}

#[test]
fn frames_are_what_a_png_folder_gives_back() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let marked: Vec<f32> = owner.model.gaussians.sh_coeffs.iter().map(|h| h * 1.01).collect();
    let held_out = HeldOut::render(&gpu, &owner.model, &marked, &cameras()).expect("films");
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, clips) in [("marked", &held_out.marked), ("clean", &held_out.clean)] {
        for (i, clip) in clips.iter().enumerate() {
            let path = folder.path().join(format!("{name}{i}"));
            write_png_folder(&path, clip).expect("writable");
            let decoded = read_clip(&path, &ReadOptions::default()).expect("our own frames");
            assert!(decoded.frames() == clip.as_slice(), "{name} clip {i} is the same after PNG");
        }
    }
}

#[test]
fn clips_are_counted_together() {
    let message = Message::from_value(0xb0, BITS).expect("eight bits");
    let reading = |m: Message| {
        let logits: Vec<f32> = m.bits().map(|b| if b { 1.0 } else { -1.0 }).collect();
        Reading::from_logits(&logits, BITS).expect("finite")
    };
    let (right, wrong) = (reading(message), reading(message.inverted()));
    let mixed =
        chance_deviation(&[vec![right.clone(); 10], vec![wrong; 10]].concat(), &message).expect("equal lengths");
    assert_eq!((mixed.matches, mixed.num_bits, mixed.state), (10 * BITS, 20 * BITS, ControlState::Quiet));
    let one_sided = chance_deviation(&vec![right; 20], &message).expect("equal lengths");
    assert_eq!((one_sided.share(), one_sided.state), (1.0, ControlState::Fires));
}

fn mark(gpu: &Gpu, owner: &Owner, subject: Subject<'_>) -> (Embedded, HeldOut) {
    let mut embedding = Embedding::prepare(subject, owner.config.clone()).expect("prepares");
    while embedding.step().expect("steps").is_some() {}
    let embedded = embedding.finish().expect("finishes");
    let film = HeldOut::render(gpu, &owner.model, &embedded.sh_coeffs, &cameras()).expect("films");
    (embedded, film)
}

#[test]
fn copies_of_other_owners_are_read_one_by_one_and_together() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let subject = owner.subject(&gpu);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("other.key");
    let file = key_file_of(&owner.clip, [9; 32], BITS);
    std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
    let other_key = Key::read(&path, &owner.clip).expect("the key fits the checkpoint");
    let other_message = other_key.own_message();
    let other = Subject { key: &other_key, message: &other_message, ..subject };
    let (own, theirs) = (mark(&gpu, &owner, subject), mark(&gpu, &owner, other));
    assert!(own.0.sh_coeffs != theirs.0.sh_coeffs, "two owners, two marks");

    let extractor = &own.0.extractor;
    let owners = [
        OtherOwner { name: "second", clips: &theirs.1.marked },
        OtherOwner { name: "absent", clips: &[] },
        OtherOwner { name: "ourselves", clips: &own.1.marked },
    ];
    let said = read_other_owners(&subject, extractor, &owners).expect("reads").expect("there are two");
    let names: Vec<_> = said.owners.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["second", "ourselves"], "who has a clip");
    let sum: u32 = said.owners.iter().map(|(_, chance_deviation)| chance_deviation.matches).sum();
    assert_eq!((said.all.matches, said.all.num_bits), (sum, 2 * BITS));
    assert_eq!(said.bits.agreeing.iter().sum::<u32>(), sum, "the same bits, counted by column");
    // The owner's own copy reads as in an evaluation.
    let evaluation = own.1.evaluate(&gpu, &owner.clip, &owner.key, extractor, &owner.message).expect("reads");
    assert_eq!(vec![said.owners[1].1.matches], evaluation.matches);
    assert_eq!(evaluation.clean_bits.agreeing.iter().sum::<u32>(), evaluation.clean_leak.matches);
    assert_eq!(evaluation.noisy_bits.agreeing.iter().sum::<u32>(), evaluation.noisy_leak.matches);
    assert!(read_other_owners(&subject, extractor, &owners[1..2]).expect("reads").is_none(), "nobody");

    let scenes = [OtherScene { name: "other", clips: &own.1.clean }];
    let witnesses = Witnesses { scenes: &scenes, other_key: &other_key, untrained: None };
    let examined = cross_examine(&subject, extractor, &own.1, &witnesses).expect("reads");
    assert_eq!(examined.other_scenes_bits, Some(evaluation.clean_bits), "the other scene is the clean one");
}
