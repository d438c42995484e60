//! The pretrained extractor: made without any owner, the same for all, and what an asset still brings itself.

use std::sync::Arc;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::base::prf::Purpose;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::watermark::embed::pretrain::{PretrainConfig, Pretraining, Scenery};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Extractor, Profile, WeightsFile};
use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::digest_of;
use nalgebra::DMatrix;

use crate::support::gpu::{Gpu, device};
use crate::support::owner::Owner;

fn settings(seed: u64) -> PretrainConfig {
    let (scenes, probes) = (vec![Scenery::Procedural(3)], vec![Scenery::Procedural(2)]);
    PretrainConfig { bits: 4, seed, scenes, probes, clips: 2, responses: 4, size_px: 32 }
}

/// All bytes of the extractor that comes of some settings; with `stop_after`, the run is broken off there and gone on
/// with.
fn pretrain(gpu: &Gpu, clip: &ClipModel, config: &PretrainConfig, stop_after: Option<usize>) -> Digest {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let checkpoint = folder.path().join("checkpoint");
    let mut training = Pretraining::prepare(gpu, clip, config.clone()).expect("prepares");
    let mut done = 0;
    while training.step().expect("steps").is_some() {
        done += 1;
        if stop_after == Some(done) {
            training.save(&checkpoint).expect("writable");
            training = Pretraining::prepare(gpu, clip, config.clone()).expect("prepares");
            training.restore(&checkpoint).expect("our own checkpoint");
        }
    }
    assert_eq!(done, config.num_scenes(), "scenes");
    for report in training.reports() {
        // No directions separate a scene better than its own.
        assert!(report.separation > 0.0 && report.separation <= 1.0 + 1e-9, "{report:?}");
    }
    training.extractor("test".to_owned()).expect("three scenes").digest().expect("serialises")
}

#[test]
fn the_same_settings_give_the_same_bytes_whoever_runs_them_and_whenever_they_stop() {
    let Some(gpu) = device() else { return };
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let first = pretrain(&gpu, &clip, &settings(0), None);
    // An owner at work beside it: nothing that belongs to a key can get into it, for it asks for none.
    let owner = Owner::new(&gpu);
    owner.prepare(&gpu).step().expect("steps");
    assert_eq!(pretrain(&gpu, &clip, &settings(0), Some(2)), first, "broken off and gone on with");
    assert_ne!(pretrain(&gpu, &clip, &settings(1), None), first, "other scenes");
}

#[test]
fn a_checkpoint_of_other_settings_is_refused() {
    let Some(gpu) = device() else { return };
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("checkpoint");
    Pretraining::prepare(&gpu, &clip, settings(0)).expect("prepares").save(&path).expect("writable");
    let error = Pretraining::prepare(&gpu, &clip, settings(1)).expect("prepares").restore(&path);
    assert!(error.expect_err("another seed").to_string().contains("identity"), "the entry is named");
    let impossible = [
        PretrainConfig { scenes: Vec::new(), ..settings(0) },
        PretrainConfig { scenes: vec![Scenery::Procedural(0)], ..settings(0) },
        PretrainConfig { probes: Vec::new(), ..settings(0) },
        PretrainConfig { clips: 0, ..settings(0) },
        PretrainConfig { responses: 3, ..settings(0) },
        PretrainConfig { scenes: vec![Scenery::Procedural(1)], responses: 16, bits: 17, ..settings(0) },
    ];
    for config in impossible {
        let refused = Pretraining::prepare(&gpu, &clip, config.clone()).map(|_| ());
        assert!(matches!(refused, Err(EngineError::Usage { .. })), "{config:?}: {refused:?}");
    }
    assert!("procedural:many".parse::<Scenery>().is_err(), "not a number");
}

#[test]
fn the_built_in_one_is_for_the_built_in_clip_and_comes_back_from_a_file() {
    let Some(gpu) = device() else { return };
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let pretrained = PretrainedExtractor::built_in().expect("our own file");
    assert_eq!(pretrained.clip, digest_of(&clip), "checkpoint");
    assert!(!pretrained.tmsd.is_trained(), "R is a colour map");
    assert!(pretrained.most_bits >= 72, "the longest message of the built-in CLIP: {}", pretrained.most_bits);
    assert!(
        pretrained.made_by.starts_with("guard4d pretrain-extractor --scenes procedural:"),
        "{}",
        pretrained.made_by
    );
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("pretrained.safetensors");
    pretrained.write(&path, Existing::Refuse).expect("writable");
    assert_eq!(PretrainedExtractor::read(&path).expect("just written"), pretrained);
    assert_eq!(Digest::of_file(&path).expect("just written"), pretrained.digest().expect("serialises"));
    let mut file = TensorFile::read(&path).expect("just written");
    let mut refused = |name: &str, change: &dyn Fn(&mut TensorFile)| {
        let before = TensorFile {
            path: path.clone(),
            ..TensorFile::from_bytes(&path, &file.to_bytes().expect("ours")).expect("ours")
        };
        change(&mut file);
        std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
        let error = PretrainedExtractor::read(&path).expect_err(name).to_string();
        assert!(error.contains(name), "`{name}` is not in: {error}");
        file = before;
    };
    refused("least_content", &|file| drop(file.meta.insert("least_content".to_owned(), "NaN".to_owned())));
    refused("clip", &|file| drop(file.meta.insert("clip".to_owned(), "c0ffee".to_owned())));
    refused("directions", &|file| file.tensors.get_mut("directions").expect("there").shape.insert(0, 1));
    refused("tmsd", &|file| drop(file.meta.remove("tmsd")));
}

fn pretrained() -> Arc<PretrainedExtractor> {
    Arc::new(PretrainedExtractor::built_in().expect("our own file"))
}

fn config(owner: &Owner) -> EmbedConfig {
    EmbedConfig::new(Profile::Draft, ExtractorMode::Pretrained).with(|c| {
        c.optimiser.steps = 2;
        c.views.clips = 3;
        c.views.size_px = (32, 32);
        c.open_weights().expect("our own file");
        c.seed = owner.config.seed;
        c.optimiser.held_out_every = 0;
    })
}

#[test]
fn of_an_asset_it_takes_colours_zero_and_scale_and_no_direction() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let embedding = Embedding::prepare(owner.subject(&gpu), config(&owner)).expect("prepares");
    let fitted = embedding.fitted();
    assert_eq!(fitted.mode, ExtractorMode::Pretrained);
    let blind = owner.prepare(&gpu);
    let map = |weights: &ExtractorWeights| weights.tmsd.as_ref().expect("R").colour_map;
    let pretrained = pretrained();
    assert_ne!(map(fitted), pretrained.tmsd.colour_map, "the asset's own colours");
    assert!(fitted.calibration.mean_logits.iter().any(|logit| *logit != 0.0), "its zero");
    let (bits, width) = (owner.key.bits(), owner.key.text_mean.len());
    let matrix = |values: &[f32], columns: usize, most: usize| {
        DMatrix::from_fn(width, columns, |i, j| f64::from(values[i * most + j]))
    };
    let span = matrix(&pretrained.directions, bits, pretrained.most_bits).qr().q();
    let beside = |weights: &ExtractorWeights| {
        let own = matrix(&weights.calibration.directions, bits, bits);
        let rest = &own - &span * span.tr_mul(&own);
        rest.norm() / own.norm()
    };
    // Directions are rounded to f32; those that `blind` fits lie elsewhere for the most part.
    assert!(beside(fitted) < 1e-5, "{} of its directions is not the pretrained one's", beside(fitted));
    assert!(beside(blind.fitted()) > 0.1, "blind fits its own: {}", beside(blind.fitted()));
    let rotation = || owner.key.prf().stream(Purpose::Calibration, 0);
    assert!(fitted.calibration.is_along(&pretrained, &mut rotation()), "what verify asks");
    assert!(!blind.fitted().calibration.is_along(&pretrained, &mut rotation()), "fitted to the asset");
    let mut bent = fitted.calibration.clone();
    bent.directions.iter_mut().step_by(bits).for_each(|v| *v *= 1.1);
    assert!(!bent.is_along(&pretrained, &mut rotation()), "one direction is a tenth longer");
    let other = PretrainedExtractor {
        directions: pretrained.directions.iter().rev().copied().collect(),
        ..pretrained.as_ref().clone()
    };
    assert!(!fitted.calibration.is_along(&other, &mut rotation()), "another pretrained extractor");
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("extractor.safetensors");
    fitted.write(&path, &owner.key, Existing::Refuse).expect("writable");
    assert_eq!(&ExtractorWeights::read(&path, &owner.key).expect("ours"), fitted);
}

#[test]
fn what_does_not_go_together_is_refused() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let few = PretrainedExtractor { most_bits: 4, directions: vec![0.1; 512 * 4], ..pretrained().as_ref().clone() };
    let other = PretrainedExtractor { clip: Digest::of(b"another CLIP"), ..pretrained().as_ref().clone() };
    let given = |weights: PretrainedExtractor| {
        let weights = WeightsFile::of(Arc::new(weights)).expect("whole");
        config(&owner).with(|c| match &mut c.extractor {
            Extractor::Pretrained(pretrained) => pretrained.weights = weights,
            other => panic!("not pretrained: {other:?}"),
        })
    };
    let unopened = EmbedConfig::new(Profile::Draft, ExtractorMode::Pretrained);
    let cases = [
        ("pretrained extractor: none, expected one that was opened", unopened),
        ("a message of 8 bits", given(few)),
        ("which the key was made with", given(other)),
    ];
    assert_eq!(config(&owner).with_probes(32), config(&owner), "it has none of its own");
    for (words, config) in cases {
        let refused = Embedding::prepare(owner.subject(&gpu), config).map(|_| ()).expect_err(words);
        assert_eq!(refused.exit_code(), 2, "{refused}");
        assert!(refused.to_string().contains(words), "`{words}` is not in: {refused}");
    }
}
