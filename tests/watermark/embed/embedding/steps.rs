//! What a training step takes, and what it shows of clips that it never sees.

use std::path::Path;
use std::sync::Arc;

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::networks::lpips::{LpipsInput, LpipsWeights};
use guard4d_engine::release::evaluate::HeldOut;
use guard4d_engine::render::OffsetBases;
use guard4d_engine::scene::{Camera, CameraSet, View};
use guard4d_engine::watermark::embed::{
    Control, EmbedConfig, Embedded, Embedding, Estimate, JointConfig, LpipsTerm, Profile, Repetition, Start,
    StepReport, WeightsFile,
};
use guard4d_engine::watermark::extractor::tmsd::{TmsdConfig, TmsdWeights};
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_kernels::KernelError;
use guard4d_kernels::vk::MemoryUse;

use crate::support::close::{assert_close, largest};
use crate::support::gpu::{Gpu, device, device_with_free, own_device, staged_device};
use crate::support::owner::{BITS, Owner};
use crate::support::random_lpips;

pub(super) fn config(owner: &Owner, mode: ExtractorMode) -> EmbedConfig {
    owner.config_of(mode).with_probes(BITS as usize).with(|c| c.views.size_px = (32, 32))
}

/// Settings of `joint`.
fn joint(config: &mut EmbedConfig) -> &mut JointConfig {
    config.extractor.joint_mut().expect("it is joint")
}

#[test]
fn a_step_allocates_nothing_even_where_the_host_cannot_see_device_memory() {
    let Some(gpu) = staged_device() else { return };
    let taken = || gpu.memory_use().allocations;
    let (plain, readback) = (gpu.buffer::<f32>("plain", 4), gpu.readback::<f32>("readback", 4));
    for (buffer, allocations) in [(plain.expect("buffer"), 1), (readback.expect("buffer"), 0)] {
        let before = taken();
        buffer.read().expect("reads");
        assert_eq!(taken() - before, allocations, "allocations of reading {buffer:?}");
    }
    let owner = Owner::new(&gpu);
    let mut fitted: Option<ExtractorWeights> = None;
    for mode in [ExtractorMode::Joint, ExtractorMode::Blind, ExtractorMode::None] {
        // Every loss, so that every kernel of a step runs.
        let lpips = Some(lpips(1.0, None, 1));
        let every_loss = config(&owner, mode).with(|c| {
            c.objective.lambda_recon = 1.0;
            c.objective.lambda_offset = 1.0;
            c.objective.lpips = lpips;
        });
        let config = every_loss.with(|c| {
            c.optimiser.steps = 6;
            c.views.clips = 1;
            c.optimiser.held_out_every = 2;
        });
        // Only `joint` trains its extractor; the others step alike on any that they are given.
        let given = fitted.take().map(|weights| without(mode, weights));
        let start = given.as_ref().map_or(Start::Fit, Start::Frozen);
        let mut embedding = Embedding::prepare_with(owner.subject(&gpu), config, start).expect("prepares");
        fitted = Some(embedding.fitted().clone());
        let mut after = Vec::new();
        for step in 1..=5 {
            let report = embedding.step().expect("steps").expect("there are six");
            assert_eq!(report.held_out.is_some(), step % 2 == 0, "{mode:?}: measured after step {step}");
            assert!(report.recon.is_finite() && report.offset.is_finite(), "{mode:?}: {report:?}");
            let all = report.recon > 0.0 && report.offset > 0.0 && report.lpips > 0.0;
            assert!(step == 1 || all, "{mode:?}, every loss: {report:?}");
            assert_eq!(report.control > 0.0, mode == ExtractorMode::Joint, "{mode:?}: {report:?}");
            after.push(taken());
        }
        assert_eq!(after[1], after[4], "{mode:?}: allocations after each step: {after:?}");
    }
}

/// What a mode that comes without the network, or without R, keeps of an extractor.
fn without(mode: ExtractorMode, weights: ExtractorWeights) -> ExtractorWeights {
    let map_alone = |t: TmsdWeights| TmsdWeights { config: TmsdConfig::colour_map_only(), layers: Vec::new(), ..t };
    let tmsd = weights.tmsd.filter(|_| mode != ExtractorMode::None).map(map_alone);
    ExtractorWeights { mode, tmsd, ..weights }
}

pub(super) type Shots = Vec<(Camera, f32)>;

/// Takes all steps.
pub(super) fn train(mut embedding: Embedding<'_>) -> (Vec<StepReport>, Embedded) {
    let reports = std::iter::from_fn(|| embedding.step().expect("steps")).collect();
    (reports, embedding.finish().expect("finishes"))
}

/// Films clips that share their times.
pub(super) fn film(gpu: &Gpu, owner: &Owner, embedded: &Embedded, clips: &[Shots]) -> HeldOut {
    let shots = clips.iter().flatten().enumerate();
    let view = |(i, (camera, time)): (usize, &(Camera, f32))| View {
        name: i.to_string(),
        camera: *camera,
        times: vec![*time],
        located: true,
    };
    let cameras = CameraSet { views: shots.map(view).collect(), in_sequence: false };
    let filmed = HeldOut::render(gpu, &owner.model, &embedded.sh_coeffs, &cameras).expect("films");
    assert_eq!(filmed.marked.len(), clips.len(), "clip by clip");
    filmed
}

#[test]
fn replayed_steps_give_the_bytes_of_steps_that_are_recorded_anew() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let blind = config(&owner, ExtractorMode::Blind).with(|c| {
        c.optimiser.steps = 4;
        c.optimiser.held_out_every = 2;
    });
    // Steps with a control and without one are two recordings; measuring comes between.
    for config in [blind, seldom(&owner, 5, 2).with(|c| c.optimiser.held_out_every = 3)] {
        let trained = |how: &[Repetition]| {
            let mut embedding = Embedding::prepare(owner.subject(&gpu), config.clone()).expect("prepares");
            let mut reports = Vec::new();
            for how in how.iter().cycle() {
                embedding.repeat(*how);
                let Some(report) = embedding.step().expect("steps") else { break };
                assert!(!embedding.recording_time().is_zero(), "a step is recorded in some time");
                reports.push(report);
            }
            let embedded = embedding.finish().expect("finishes");
            let bits: Vec<u32> = embedded.sh_coeffs.iter().map(|v| v.to_bits()).collect();
            let kernels: Vec<_> = embedded.device_seconds.keys().copied().collect();
            (reports, bits, embedded.extractor, kernels)
        };
        let anew = trained(&[Repetition::RecordedAnew]);
        assert!(anew == trained(&[Repetition::Replayed]), "{}: replayed", config.mode());
        assert!(anew == trained(&[Repetition::Replayed, Repetition::RecordedAnew]), "{}: by turns", config.mode());
    }
}

/// Settings of a short `joint` with a control in every `every`-th step.
fn seldom(owner: &Owner, steps: usize, every: u32) -> EmbedConfig {
    config(owner, ExtractorMode::Joint).with(|c| {
        c.optimiser.steps = steps;
        joint(c).control_every = every;
        joint(c).tmsd_held = 0.0;
    })
}

#[test]
fn every_second_step_has_a_control_clean_and_noisy_by_turns_also_after_a_break() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = seldom(&owner, 6, 2);
    let prepare = |config: &EmbedConfig| Embedding::prepare(owner.subject(&gpu), config.clone()).expect("prepares");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut first = prepare(&config);
    let mut reports = vec![first.step().expect("steps").expect("there are six")];
    // The next step has no control, and asks for what is remembered of this one's.
    first.save(&path).expect("saves");
    let (rest, unbroken) = train(first);
    reports.extend(rest);
    for (step, report) in reports.iter().enumerate() {
        assert_eq!(report.control > 0.0, step % 2 == 0, "step {step}: {report:?}");
        assert!(report.control >= 0.0, "step {step}: {report:?}");
    }

    let mut second = prepare(&config);
    second.restore(&path).expect("restores");
    let (rest, resumed) = train(second);
    assert_eq!(rest, reports[1..], "what the steps after the break see");
    let bits = |e: &Embedded| e.sh_coeffs.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(&unbroken) == bits(&resumed), "the same mark with and without a break");
    assert_eq!(unbroken.extractor, resumed.extractor, "and the same extractor");

    // The control of step 0 is clean and that of step 2 noisy: only the latter knows how far the noise ranges. Fitting
    // takes the middle of the range, which stays.
    let (low, high) = config.objective.noise_sigma;
    let mut noisier = prepare(&config.with(|c| c.objective.noise_sigma = (low / 4.0, high * 4.0)));
    for (step, quiet) in reports.iter().enumerate().take(3) {
        let loud = noisier.step().expect("steps").expect("there are six");
        assert_eq!(loud.control != quiet.control, step == 2, "step {step}: {loud:?}, {quiet:?}");
    }
}

#[test]
fn r_is_held_for_a_share_of_the_steps_and_then_trained_also_after_a_break() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    // Two of four steps are held; the third has a clean control, the fourth a noisy one.
    let config = seldom(&owner, 4, 1).with(|c| joint(c).tmsd_held = 0.5);
    let prepare = || Embedding::prepare(owner.subject(&gpu), config.clone()).expect("prepares");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let layers = |embedding: &mut Embedding<'_>| {
        embedding.save(&path).expect("saves");
        let file = TensorFile::read(&path).expect("a checkpoint");
        let of = |name: &str| file.tensors[name].shape.clone();
        let read = |name: &str| file.finite(name, &of(name)).expect("numbers").to_vec();
        [read("tmsd.2.param"), read("tmsd.2.exp_avg")]
    };
    let mut first = prepare();
    let fitted = layers(&mut first);
    let mut reports = Vec::new();
    for step in 0..2 {
        let report = first.step().expect("steps").expect("there are four");
        assert!(report.control == 0.0 && report.message > 0.0, "held step {step}: {report:?}");
        reports.push(report);
    }
    assert_eq!(layers(&mut first), fitted, "R as it was fitted, and Adam knows of no gradient");
    let (rest, unbroken) = train(first);
    assert!(rest.iter().all(|report| report.control > 0.0), "{rest:?}");
    let mut second = prepare();
    second.restore(&path).expect("restores");
    let (resumed_rest, resumed) = train(second);
    assert_eq!(resumed_rest, rest, "what the steps after the break see");
    assert!(coefficients(&unbroken) == coefficients(&resumed), "the same mark with and without a break");
    assert_eq!(unbroken.extractor, resumed.extractor, "and the same extractor");
    assert_ne!(unbroken.extractor.tmsd, prepare().fitted().tmsd, "R is trained in the end");
    for tmsd_held in [-0.1, 1.0, f32::NAN] {
        let refused =
            config.clone().with(|c| joint(c).tmsd_held = tmsd_held).validate().expect_err("impossible").to_string();
        assert!(refused.contains("tmsd_held"), "{tmsd_held}: {refused}");
    }
}

/// Adam's first moment of R's last layer, a tenth of its gradient, and the offsets after one step; with the checkpoint.
fn first_moments(embedding: &mut Embedding<'_>, path: &Path) -> (Vec<f32>, Vec<f32>) {
    embedding.step().expect("steps").expect("there is one");
    embedding.save(path).expect("saves");
    let file = TensorFile::read(path).expect("a checkpoint");
    let floats = |name: &str| {
        let shape = file.tensors[name].shape.clone();
        file.finite(name, &shape).expect("numbers").to_vec()
    };
    (floats("tmsd.2.exp_avg"), floats("offsets.param"))
}

#[test]
fn a_control_counts_as_often_as_it_is_left_out() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |every: u32| folder.path().join(every.to_string());
    let mut embeddings =
        [1, 2, 3].map(|every| Embedding::prepare(owner.subject(&gpu), seldom(&owner, 1, every)).expect("prepares"));
    let mut every = 0;
    let after = embeddings.each_mut().map(|embedding| {
        every += 1;
        first_moments(embedding, &path(every))
    });
    let [once, twice, thrice] = after.each_ref().map(|(moments, _)| moments);
    let difference = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>();
    let most = |values: &[f32]| largest(values.iter().map(|v| v.abs()));
    let (second, third) = (difference(twice, once), difference(thrice, twice));
    assert!(most(&second) > 1e-3 * most(thrice), "a control has a gradient: {}", most(&second));
    // Sums of 8192 pixels' products whose factors are rounded after a multiplication by three: 2^-24 · √8192 of the
    // largest is 5e-6, and the way back through CLIP takes some more.
    assert_close(&third, &second, 1e-4 * most(thrice), 0.0);
    // The offsets see the marked clip alone.
    let bits = |offsets: &[f32]| offsets.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(after.iter().all(|(_, offsets)| bits(offsets) == bits(&after[0].1)), "the same offsets");

    let refused = embeddings[2].restore(&path(2)).expect_err("other settings");
    assert!(matches!(&refused, EngineError::BadData { field, .. } if field == "identity"), "{refused}");
}

/// Offsets of a trained mark, as bits.
fn coefficients(embedded: &Embedded) -> Vec<u32> {
    embedded.sh_coeffs.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn steps_go_through_distortions_and_come_back() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    for mode in [ExtractorMode::Blind, ExtractorMode::Joint] {
        let plain = config(&owner, mode).with(|c| {
            c.optimiser.steps = 4;
            c.objective.lambda_recon = 1.0;
        });
        let with = |list: &[&str]| {
            let distortions = list.iter().map(|text| text.parse().expect("well written")).collect();
            let config = plain.clone().with(|c| c.objective.distortions = distortions);
            train(Embedding::prepare(owner.subject(&gpu), config).expect("prepares"))
        };
        // A detour that changes nothing changes nothing; controls would be clean where they are noisy by turns.
        let ((without, unmoved), (reports, same)) = (with(&[]), with(&["identity"]));
        if mode == ExtractorMode::Blind {
            assert_eq!(without, reports, "what the steps see");
            assert!(coefficients(&unmoved) == coefficients(&same), "the same mark");
        }
        let (reports, other) = with(&["rotation:-30..30", "jpeg:30", "noise:0.05", "codec:2", "crop:0.5..0.9"]);
        assert!(coefficients(&unmoved) != coefficients(&other), "{mode:?}: a distortion tells");
        let finite = |r: &StepReport| r.total.is_finite() && r.mse.is_finite();
        assert!(reports.len() == 4 && reports.iter().all(finite), "{mode:?}: {reports:?}");
        let (again, repeated) = with(&["rotation:-30..30", "jpeg:30", "noise:0.05", "codec:2", "crop:0.5..0.9"]);
        assert_eq!(reports, again, "{mode:?}: the same draws");
        assert!(coefficients(&other) == coefficients(&repeated), "{mode:?}: and the same mark");
    }
}

#[test]
fn no_offset_exceeds_its_bound() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    // Colour per unit of a DC coefficient: 1 / (2 sqrt(pi)).
    let dc = 0.282_094_8f32;
    let largest = |bases: OffsetBases, max_offset: Option<f32>| {
        let config = config(&owner, ExtractorMode::Blind).with(|c| {
            c.optimiser.steps = 6;
            c.fidelity.max_offset = max_offset;
            c.fidelity.bases = bases;
        });
        let (_, embedded) = train(Embedding::prepare(owner.subject(&gpu), config).expect("prepares"));
        let pairs = embedded.sh_coeffs.iter().zip(&owner.model.gaussians.sh_coeffs);
        largest(pairs.map(|(marked, clean)| dc * (marked - clean).abs()))
    };
    let degree = owner.model.gaussians.sh_degree;
    for (bases, used) in [(OffsetBases::All, (degree + 1).pow(2)), (OffsetBases::Dc, 1)] {
        // The bound is that of sixteen coefficients; fewer may add as much light.
        let (free, bound) = (largest(bases, None), 5e-4);
        let most = bound * (16.0 / used as f32).sqrt();
        assert!(free > 2.0 * most, "without a bound: {free}");
        let bounded = largest(bases, Some(bound));
        // Some offset is at the bound; coefficients of about 2 are rounded by 1e-7.
        assert!((bounded - most).abs() < 2e-7, "{bases:?}: {bounded}");
    }
    let default = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind);
    let of = |config: &EmbedConfig| config.fidelity.max_offset.expect("has one");
    let louder = default.clone().with_target(default.fidelity.target_psnr - 20.0);
    assert!((of(&louder) / of(&default) - 10.0).abs() < 1e-4, "ten times as strong at 20 dB less");
    for bad in [-1e-3, f32::NAN, f32::INFINITY] {
        let refused = default.clone().with(|c| c.fidelity.max_offset = Some(bad)).validate().expect_err("no bound");
        assert!(refused.to_string().contains("max_offset"), "{bad}: {refused}");
    }
}

/// LPIPS with a random network.
fn lpips(lambda: f32, crop_px: Option<u32>, every: u32) -> LpipsTerm {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let weights = LpipsWeights::read(&random_lpips::write(folder.path())).expect("complete");
    LpipsTerm {
        network: WeightsFile::of(Arc::new(weights)).expect("whole"),
        input: LpipsInput::Canonical,
        lambda,
        crop_px,
        every,
    }
}

#[test]
fn lpips_joins_the_loss_in_its_turn_also_after_a_break() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let plain = config(&owner, ExtractorMode::None).with(|c| {
        c.optimiser.steps = 5;
        c.views.size_px = (40, 36);
    });
    let with = |term: LpipsTerm| plain.clone().with(|c| c.objective.lpips = Some(term));
    let prepare = |config: EmbedConfig| Embedding::prepare(owner.subject(&gpu), config).expect("prepares");
    let bits = |e: &Embedded| e.sh_coeffs.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let (without, unweighted) = (train(prepare(plain.clone())), train(prepare(with(lpips(0.0, None, 1)))));
    assert_eq!(without.0, unweighted.0, "a weight of 0 changes no step");
    assert!(bits(&without.1) == bits(&unweighted.1), "nor the mark");

    let seldom = with(lpips(10.0, Some(32), 2));
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("checkpoint.safetensors");
    let mut first = prepare(seldom.clone());
    let mut reports = vec![first.step().expect("steps").expect("there are five")];
    first.save(&path).expect("saves");
    let (rest, unbroken) = train(first);
    reports.extend(rest);
    for (step, report) in reports.iter().enumerate() {
        // Before the first step there is no mark to see.
        assert_eq!(report.lpips > 0.0, step == 2 || step == 4, "step {step}: {report:?}");
        assert!(report.lpips >= 0.0, "step {step}: {report:?}");
    }
    assert!(bits(&unbroken) != bits(&without.1), "it has a gradient");
    let mut second = prepare(seldom.clone());
    second.restore(&path).expect("restores");
    let (rest, resumed) = train(second);
    assert_eq!(rest, reports[1..], "what the steps after the break see");
    assert!(bits(&unbroken) == bits(&resumed), "the same mark with and without a break");

    let mut whole = prepare(with(LpipsTerm { crop_px: None, ..lpips(10.0, None, 2) }));
    let refused = whole.restore(&path).expect_err("other settings");
    assert!(matches!(&refused, EngineError::BadData { field, .. } if field == "identity"), "{refused}");
    let said = serde_json::to_value(&seldom).expect("JSON")["objective"]["lpips"].clone();
    let digest = lpips(0.0, None, 1).network.get().expect("open").digest().to_string();
    assert_eq!(said["network"], serde_json::json!({ "blake3": digest }), "{said}");
    assert_eq!(
        (&said["input"], &said["crop_px"], &said["every"]),
        (&"canonical".into(), &32.into(), &2.into()),
        "{said}"
    );
}

#[test]
fn what_lpips_keeps_of_clips_changes_no_result_and_is_estimated() {
    // What is kept of a clip is 5 MB then.
    const SIDE: u32 = 128;
    let settings = |crop_px: Option<u32>| {
        let gpu = own_device()?;
        let owner = Owner::new(&gpu);
        let lpips = Some(lpips(10.0, crop_px, 1));
        let config = config(&owner, ExtractorMode::Blind).with(|c| {
            c.optimiser.steps = 8;
            c.views.clips = 4;
            c.views.size_px = (SIDE, SIDE);
            c.objective.lpips = lpips;
        });
        let estimate = Estimate::of(owner.subject(&gpu), &config).expect("estimates");
        drop((owner, gpu));
        let (embedded, used) = within(None, &config)?;
        let off = estimate.peak_memory_bytes as f64 / used.peak_reserved_bytes as f64;
        assert!((0.95..1.05).contains(&off), "the estimate is within 5 %: {estimate:?}, {used:?}");
        Some((config, embedded, used.peak_reserved_bytes))
    };
    // A part as large as the frame is the same to compare, but parts are not kept.
    let (Some((config, kept, more)), Some((_, anew, less))) = (settings(None), settings(Some(SIDE))) else { return };
    let bits = |e: &Embedded| e.sh_coeffs.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(&kept) == bits(&anew), "the same mark to the bit");
    assert!(more > less + (10 << 20), "two clips' at the least are kept: {more}, {less}");
    // Room for all clips, and for what is kept of some.
    let budget = u64::midpoint(more, less);
    let Some((tight, used)) = within(Some(budget), &config) else { return };
    assert!(used.peak_reserved_bytes <= budget && tight.clips_made == 4, "no clip goes for it: {used:?} with {budget}");
    assert!(bits(&kept) == bits(&tight), "the same mark with room for some");
}

#[test]
fn impossible_lpips_is_refused() {
    let config = |term: LpipsTerm| {
        let config = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind);
        config.with(|c| {
            c.objective.lpips = Some(term);
            c.views.size_px = (64, 40);
        })
    };
    config(lpips(1.0, Some(31), 1)).validate().expect("the least");
    config(lpips(1.0, Some(500), 1)).validate().expect("whole frames are all that there is");
    for (term, what) in [
        (lpips(-1.0, None, 1), "lambda_lpips: -1"),
        (lpips(f32::NAN, None, 1), "lambda_lpips: NaN"),
        (lpips(1.0, None, 0), "lpips_every: 0"),
        (lpips(1.0, Some(30), 1), "compares: 30, expected at least 31 px"),
    ] {
        let refused = config(term).validate().expect_err(what).to_string();
        assert!(refused.contains(what), "{refused}");
    }
}

#[test]
fn settings_name_the_steps_between_controls() {
    let usual = EmbedConfig::new(Profile::Draft, ExtractorMode::Joint);
    let said = |config: &EmbedConfig| serde_json::to_value(config).expect("JSON")["extractor"]["control_every"].clone();
    assert_eq!(said(&usual), 1);
    let seldom = usual.clone().with(|c| joint(c).control_every = 4);
    assert_eq!(said(&seldom), 4);
    seldom.validate().expect("possible");
    let refused = usual.with(|c| joint(c).control_every = 0).validate().expect_err("impossible").to_string();
    assert!(refused.contains("control_every: 0"), "{refused}");
    let blind = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind);
    assert!(said(&blind).is_null() && blind.extractor.joint().is_none(), "the others have no place for it");
}

/// An embedding on a device of its own that takes at most `budget`, with the most that was taken.
fn within(budget: Option<u64>, config: &EmbedConfig) -> Option<(Embedded, MemoryUse)> {
    embed_on(&own_device()?, budget, config)
}

fn embed_on(gpu: &Gpu, budget: Option<u64>, config: &EmbedConfig) -> Option<(Embedded, MemoryUse)> {
    let owner = Owner::new(gpu);
    if let Some(budget) = budget {
        gpu.limit_memory(budget);
    }
    let (_, embedded) = train(Embedding::prepare(owner.subject(gpu), config.clone()).expect("prepares"));
    Some((embedded, gpu.memory_use()))
}

#[test]
fn a_memory_budget_costs_time_and_changes_no_result() {
    let Some(gpu) = own_device() else { return };
    let owner = Owner::new(&gpu);
    let config = config(&owner, ExtractorMode::Blind).with(|c| {
        c.optimiser.steps = 3;
        c.views.clips = 4;
        c.optimiser.held_out_every = 2;
    });
    let estimate = Estimate::of(owner.subject(&gpu), &config).expect("estimates");
    assert_eq!((estimate.clips, estimate.clips_in_memory, estimate.budget_bytes), (6, 6, None), "{estimate:?}");
    drop((owner, gpu));
    let Some((free, most)) = within(None, &config) else { return };
    assert_eq!(free.clips_made, 6, "each once");
    let off = estimate.peak_memory_bytes as f64 / most.peak_reserved_bytes as f64;
    assert!((0.95..1.05).contains(&off), "the estimate is within 5 %: {estimate:?}, {most:?}");

    assert!(!free.recomputed, "memory enough");
    // Moments of the asset go after all clips: eight of training, eight of what is held out.
    let moments = 16 * 12 * size_of::<f32>() as u64 * estimate.splats as u64;
    // One clip can be held, yet to make one takes some more. Activations that can be computed again, 5 MB of two layers
    // with 520 rows, are more than that.
    let with_clips = |clips: u64| estimate.resident_bytes + clips * estimate.clip_bytes;
    let budgets = [with_clips(3), with_clips(1) - moments];
    for (budget, recomputed) in budgets.into_iter().zip([false, true]) {
        let Some((tight, used)) = within(Some(budget), &config) else { return };
        assert!(tight.clips_made > 6, "clips had to go: {} were made", tight.clips_made);
        assert_eq!(tight.recomputed, recomputed, "{used:?} with {budget}");
        assert!(used.peak_reserved_bytes <= budget, "{used:?} with {budget}");
        let bits = |e: &Embedded| e.sh_coeffs.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert!(bits(&free) == bits(&tight), "the same mark to the bit");
        assert_eq!(free.extractor, tight.extractor, "and the same extractor");
    }
    // Nobody set a budget, and the machine has little left: three quarters of this are the larger one.
    let Some(small) = device_with_free(budgets[0] / 3 * 4 + 4) else { return };
    let Some((tight, used)) = embed_on(&small, None, &config) else { return };
    assert!(tight.clips_made > 6 && used.peak_reserved_bytes <= budgets[0] + 3, "{used:?}");
    assert_eq!(free.extractor, tight.extractor, "the run goes on, to the same");
}

#[test]
fn a_budget_that_holds_no_clip_is_refused_by_name() {
    let Some(gpu) = own_device() else { return };
    let owner = Owner::new(&gpu);
    gpu.limit_memory(gpu.memory_use().reserved_bytes);
    let refused = Embedding::prepare(owner.subject(&gpu), config(&owner, ExtractorMode::Blind)).err().expect("no room");
    assert!(matches!(refused, EngineError::Kernel(KernelError::OverBudget { .. })), "{refused:?}");
}

#[test]
fn the_papers_profiles_have_its_weights_and_keep_them() {
    for (profile, mode) in [
        (Profile::Faithful, ExtractorMode::Joint),
        (Profile::Guardsplat, ExtractorMode::None),
        (Profile::MultiFrame, ExtractorMode::None),
    ] {
        assert_eq!(profile.default_mode(), mode, "{profile:?}");
        let config = EmbedConfig::new(profile, mode);
        config.validate().expect("sensible");
        let weights = [
            config.objective.lambda_msg,
            config.objective.lambda_recon,
            config.objective.lambda_ssim,
            config.objective.lambda_offset,
        ];
        // Guard4D Sec. 4.1, and GuardSplat's share of SSIM.
        assert_close(&weights, &[0.03, 1.0, 0.2, 10.0], 0.0, 0.0);
        // Rates of 5e-3 and 2.5e-4; the product is off by a rounding.
        assert_close(
            &[config.optimiser.lr_dc, config.optimiser.lr_dc * config.optimiser.lr_rest_share],
            &[5e-3, 2.5e-4],
            0.0,
            1e-6,
        );
        assert_eq!(config.fidelity.max_offset, None, "{profile:?}: the paper bounds offsets by their penalty");
        let held = config.clone().with_target(44.0);
        assert_close(
            &[held.fidelity.target_psnr, held.optimiser.lr_dc, held.objective.margin],
            &[44.0, 5e-3, 0.0],
            0.0,
            0.0,
        );
    }
    for (text, want) in [
        ("inverse-bce:0.000001", Control::InverseBce { eps: 1e-6 }),
        ("hinge:0.5", Control::Hinge { eps: 0.5 }),
        ("chance", Control::Chance),
    ] {
        assert_eq!(text.parse::<Control>().expect("well written"), want, "{text}");
    }
    for text in ["", "inverse-bce", "hinge:0", "hinge:NaN", "chance:1", "bce:1"] {
        let refused = text.parse::<Control>().expect_err(text).to_string();
        assert!(refused.contains("inverse-bce:EPS"), "{text}: {refused}");
    }
}

#[test]
fn clips_of_the_multi_frame_baseline_have_one_camera_and_those_of_the_single_frame_one_many() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    for (profile, cameras) in [(Profile::Guardsplat, 8), (Profile::MultiFrame, 1)] {
        let base = config(&owner, ExtractorMode::None);
        let config = base.with(|c| {
            c.profile = profile;
            c.optimiser.steps = 1;
            c.views.turn_deg = 0.0;
        });
        let embedding = Embedding::prepare(owner.subject(&gpu), config).expect("prepares");
        for clip in embedding.training_shots() {
            let mut poses: Vec<_> =
                clip.iter().map(|(c, _)| c.world_to_camera.to_cols_array().map(f32::to_bits)).collect();
            poses.sort_unstable();
            poses.dedup();
            assert_eq!(poses.len(), cameras, "{profile:?}");
        }
    }
}
