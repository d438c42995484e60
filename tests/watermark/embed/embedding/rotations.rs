//! Choosing among a key's rotations: what is tried, what is taken, and what it costs a p-value.

use guard4d_engine::base::output::Existing;
use guard4d_engine::base::prf::Purpose;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::id_code::SearchedP;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, Profile, Start, StepReport};
use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;
use guard4d_engine::watermark::extractor::rotation::{KeyRotation, MAX_ROTATIONS};
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;

use crate::support::gpu::{Gpu, device};
use crate::support::owner::Owner;

const ROTATIONS: u32 = 3;

fn config(owner: &Owner, mode: ExtractorMode) -> EmbedConfig {
    owner.config_of(mode).with_rotations(ROTATIONS).with(|config| {
        config.extractor.calibration_mut().into_iter().for_each(|calibration| calibration.copies.clear());
    })
}

fn prepare<'a>(gpu: &'a Gpu, owner: &'a Owner, config: &EmbedConfig) -> Embedding<'a> {
    Embedding::prepare(owner.subject(gpu), config.clone()).expect("prepares")
}

fn rest(embedding: &mut Embedding<'_>) -> Vec<StepReport> {
    std::iter::from_fn(|| embedding.step().expect("steps")).collect()
}

fn coefficients(embedded: &Embedded) -> Vec<u32> {
    embedded.sh_coeffs.iter().map(|v| v.to_bits()).collect()
}

/// The rotation with the least loss in the second halves of the try-outs.
fn best(tried: &[StepReport]) -> u32 {
    let each = tried.len() / ROTATIONS as usize;
    let loss = |of: &[StepReport]| of[each / 2..].iter().map(|report| f64::from(report.message)).sum::<f64>();
    let losses: Vec<f64> = tried.chunks_exact(each).map(loss).collect();
    assert!(losses.iter().all(|loss| loss.is_finite()) && losses.len() == ROTATIONS as usize, "{losses:?}");
    (0..ROTATIONS).min_by(|a, b| losses[*a as usize].total_cmp(&losses[*b as usize])).expect("there are three")
}

#[test]
fn each_rotation_is_tried_the_best_stays_and_the_mark_is_as_if_it_had_been_there_from_the_start() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    for mode in [ExtractorMode::Blind, ExtractorMode::Pretrained] {
        let config = config(&owner, mode);
        let mut embedding = prepare(&gpu, &owner, &config);
        assert_eq!(embedding.fitted().key_rotation, KeyRotation::FIXED, "before any is tried");
        let (done, all) = embedding.progress();
        assert_eq!(done, 0);
        let reports = rest(&mut embedding);
        assert_eq!((reports.len(), embedding.progress()), (all, (all, all)), "{mode}: steps");
        let (tried, trained) = reports.split_at(all - config.optimiser.steps);
        let each = tried.len() / ROTATIONS as usize;
        for (step, report) in tried.iter().enumerate() {
            assert_eq!(report.key_rotation, u32::try_from(step / each).ok(), "{mode}: try-out step {step}");
        }
        assert!(trained.iter().all(|report| report.key_rotation.is_none()), "{mode}: training");
        let embedded = embedding.finish().expect("finishes");
        assert_eq!(
            embedded.extractor.key_rotation,
            KeyRotation { number: best(tried), of: ROTATIONS },
            "{mode}: the one that stays"
        );
        assert_eq!(embedded.steps, config.optimiser.steps, "{mode}: try-outs are no steps of training");

        let start = Start::Frozen(&embedded.extractor);
        let mut again = Embedding::prepare_with(owner.subject(&gpu), config, start).expect("prepares");
        assert_eq!(rest(&mut again), trained, "{mode}: nothing of a try-out is left");
        let again = again.finish().expect("finishes");
        assert!(coefficients(&again) == coefficients(&embedded), "{mode}: the same mark");
    }
}

#[test]
fn a_break_among_the_try_outs_or_after_them_changes_nothing() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = config(&owner, ExtractorMode::Blind);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut unbroken = prepare(&gpu, &owner, &config);
    let reports = rest(&mut unbroken);
    let unbroken = unbroken.finish().expect("finishes");
    let tried = reports.len() - config.optimiser.steps;
    // In the second try-out, after all of them, and after a step of training. What is tried is tried again from the
    // first on.
    for (breaks, left) in [(tried / 2, 0), (tried, tried), (tried + 1, tried + 1)] {
        let mut first = prepare(&gpu, &owner, &config);
        for _ in 0..breaks {
            first.step().expect("steps").expect("there are more");
        }
        first.save(&path).expect("saves");
        let mut second = prepare(&gpu, &owner, &config);
        second.restore(&path).expect("restores");
        assert_eq!(rest(&mut second), reports[left..], "broken off after {breaks} steps");
        let resumed = second.finish().expect("finishes");
        assert!(coefficients(&resumed) == coefficients(&unbroken), "broken off after {breaks} steps: the same mark");
        assert_eq!(resumed.extractor, unbroken.extractor, "broken off after {breaks} steps: the same extractor");
    }
    // The last checkpoint, of another rotation than there are.
    let mut file = TensorFile::read(&path).expect("a checkpoint");
    file.meta.insert("key_rotation".to_owned(), ROTATIONS.to_string());
    std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
    let refused = prepare(&gpu, &owner, &config).restore(&path).expect_err("three are 0, 1 and 2").to_string();
    assert!(refused.contains("key_rotation") && refused.contains("below 3"), "{refused}");
}

#[test]
fn an_extractor_file_names_its_rotation_and_what_it_was_chosen_from() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let fitted = owner.prepare(&gpu).fitted().clone();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("extractor.safetensors");
    let write =
        |key_rotation| ExtractorWeights { key_rotation, ..fitted.clone() }.write(&path, &owner.key, Existing::Replace);
    for key_rotation in [
        KeyRotation::FIXED,
        KeyRotation { number: 2, of: 3 },
        KeyRotation { number: MAX_ROTATIONS - 1, of: MAX_ROTATIONS },
    ] {
        write(key_rotation).expect("writable");
        assert_eq!(ExtractorWeights::read(&path, &owner.key).expect("ours").key_rotation, key_rotation);
        let named = TensorFile::read(&path).expect("ours").meta.contains_key("mixing");
        assert_eq!(named, key_rotation != KeyRotation::FIXED, "without a choice files are as they were");
    }
    for (number, of, field) in [(3, "3", "mixing"), (0, "0", "mixings"), (0, "257", "mixings"), (0, "many", "mixings")]
    {
        write(KeyRotation { number: 2, of: 3 }).expect("writable");
        let mut file = TensorFile::read(&path).expect("ours");
        file.meta.insert("mixing".to_owned(), number.to_string());
        file.meta.insert("mixings".to_owned(), of.to_owned());
        std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
        match ExtractorWeights::read(&path, &owner.key) {
            Err(EngineError::BadData { field: named, .. }) => assert_eq!(named, field, "{number} of {of}"),
            other => panic!("{number} of {of}: {other:?}"),
        }
    }
    let mut file = TensorFile::read(&path).expect("ours");
    file.meta.insert("mixing".to_owned(), "1".to_owned());
    file.meta.remove("mixings");
    std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
    let half = ExtractorWeights::read(&path, &owner.key).expect_err("of how many?").to_string();
    assert!(half.contains("mixings"), "{half}");
}

/// A pretrained extractor can have been turned in as many ways as it says, and in no other.
#[test]
fn a_pretrained_extractor_is_mixed_by_the_rotation_that_it_names() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = config(&owner, ExtractorMode::Pretrained);
    let pretrained = PretrainedExtractor::built_in().expect("our own file");
    let mut embedding = prepare(&gpu, &owner, &config);
    while embedding.step().expect("steps").is_some() {}
    let ExtractorWeights { calibration, key_rotation, .. } = embedding.finish().expect("finishes").extractor;
    for number in 0..4 {
        let mut rotation = owner.key.prf().stream(Purpose::Calibration, number);
        let is_named = number == u64::from(key_rotation.number);
        assert_eq!(
            calibration.is_along(&pretrained, &mut rotation),
            is_named,
            "key_rotation {number}, named {key_rotation:?}"
        );
    }
}

#[test]
fn a_choice_is_paid_for_in_every_p_value() {
    let logits: Vec<f32> = (0..24_u8).map(|i| 1.0 + f32::from(i)).collect();
    let reading = Reading::from_logits(&logits, 24).expect("24 logits");
    let message = reading.decoded();
    let alone = SearchedP::of(&reading, &message, 1).expect("fits");
    let chosen = alone.among(16);
    // Powers of two: exact in floating point.
    assert_eq!((chosen.matches, chosen.soft_score), (16.0 * alone.matches, 16.0 * alone.soft_score));
    assert_eq!(chosen.searched, 16);
    assert_eq!(SearchedP::of(&reading, &message, 4096).expect("fits").among(16).searched, 65_536, "both searches");
    let hopeless = SearchedP { matches: 0.5, soft_score: f64::NAN, searched: 1 }.among(4);
    assert!(hopeless.matches == 1.0 && hopeless.soft_score.is_nan(), "{hopeless:?}");
}

#[test]
fn only_extractors_that_know_nothing_else_of_the_message_choose() {
    for mode in ExtractorMode::ALL {
        let mut config = EmbedConfig::new(Profile::Draft, mode);
        config.open_weights().expect("our own file");
        let chooses = matches!(mode, ExtractorMode::Blind | ExtractorMode::Pretrained);
        assert_eq!(config.extractor.rotations_mut().is_some(), chooses, "{mode}: the others have no place for them");
        for (rotations, fine) in
            [(0, false), (1, true), (16, chooses), (MAX_ROTATIONS, chooses), (MAX_ROTATIONS + 1, false)]
        {
            let checked = config.clone().with_rotations(rotations).validate();
            match checked {
                Ok(()) => assert!(fine || !chooses, "{mode}: {rotations}"),
                Err(EngineError::Usage { what, .. }) => {
                    assert!(!fine && what == "rotations", "{mode}: {rotations}, {what}")
                }
                Err(other) => panic!("{mode}: {rotations}: {other}"),
            }
        }
        let asked = config.with_rotations(16).extractor.rotations();
        assert_eq!(asked, if chooses { 16 } else { 1 }, "{mode}");
    }
}
