//! The whole way, small: embed, stop and go on, deliver, take out again, verify.

use std::fs;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use guard4d_engine::base::observer::Progress;
use guard4d_engine::base::output::Existing;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::detect::request::{VerifyInputs, VerifyRequest};
use guard4d_engine::detect::sought::Sought;
use guard4d_engine::detect::suspect::Suspect;
use guard4d_engine::detect::verify_cache::VerifyCache;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::judgement::PStatement;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::release::delivery::{EXTRACTOR, MARKED, PRIVATE, RECEIPT, UNDO};
use guard4d_engine::release::receipt::Receipt;
use guard4d_engine::release::undo;
use guard4d_engine::render::{OffsetBases, render_frames};
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, JointConfig, Profile, StepReport};
use guard4d_engine::watermark::extractor::tmsd::TmsdConfig;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;

use crate::support::files_below;
use crate::support::gpu::{Gpu, device};
use crate::support::owner::{BITS, Owner, cameras};

/// Steps before the checkpoint.
const FIRST: usize = 2;
const PLY: &str = "point_cloud/iteration_20000/point_cloud.ply";

/// All steps; leaves a checkpoint at `path` after the first few.
fn embed(gpu: &Gpu, owner: &Owner, path: Option<&Path>) -> Embedded {
    let mut embedding = owner.prepare(gpu);
    while embedding.step().expect("steps").is_some() {
        if let Some(path) = path.filter(|_| embedding.step_number() == FIRST) {
            embedding.save(path).expect("saves");
        }
    }
    embedding.finish().expect("finishes")
}

fn resume(gpu: &Gpu, owner: &Owner, path: &Path) -> Embedded {
    let mut embedding = owner.prepare(gpu);
    let mut file = TensorFile::read(path).expect("a checkpoint");
    file.meta.insert("identity".to_owned(), "0".repeat(64));
    let foreign = path.with_file_name("foreign.safetensors");
    fs::write(&foreign, file.to_bytes().expect("serialises")).expect("writable");
    let refused = embedding.restore(&foreign).expect_err("another embedding's checkpoint");
    assert!(matches!(&refused, EngineError::BadData { field, .. } if field == "identity"), "{refused}");
    embedding.restore(path).expect("restores");
    assert_eq!(embedding.step_number(), FIRST, "goes on where it stopped");
    while embedding.step().expect("steps").is_some() {}
    embedding.finish().expect("finishes")
}

fn assert_same(owner: &Owner, a: &Embedded, b: &Embedded, what: &str) {
    let bits = |e: &Embedded| e.sh_coeffs.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert!(bits(a) == bits(b), "{what}: coefficients");
    let digest = |e: &Embedded| e.extractor.digest(&owner.key).expect("a digest");
    assert_eq!(digest(a), digest(b), "{what}: extractor");
}

fn bytes(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Names of the float properties, and where the body of a PLY begins.
fn layout(ply: &[u8]) -> (Vec<String>, usize) {
    let mark = b"end_header\n";
    let end = ply.windows(mark.len()).position(|w| w == mark).expect("a head") + mark.len();
    let head = std::str::from_utf8(&ply[..end]).expect("the head is text");
    let names = head.lines().filter_map(|line| line.strip_prefix("property float ")).map(str::to_owned);
    (names.collect(), end)
}

fn assert_only_colour_changed(original: &[u8], marked: &[u8]) {
    let (names, start) = layout(original);
    assert_eq!(original.len(), marked.len(), "length");
    assert_eq!(original[..start], marked[..start], "head");
    let floats = |ply: &[u8]| ply[start..].as_chunks::<4>().0.to_vec();
    let mut changed = 0;
    for (i, (a, b)) in floats(original).iter().zip(&floats(marked)).enumerate() {
        let name = &names[i % names.len()];
        if a != b {
            assert!(name.starts_with("f_dc_") || name.starts_with("f_rest_"), "{name} of splat {}", i / names.len());
            changed += 1;
        }
    }
    assert!(changed > 0, "there is a mark");
}

#[test]
fn the_same_seed_gives_the_same_bytes_with_or_without_a_break() {
    let Some(gpu) = device() else { return };
    let mut owner = Owner::new(&gpu);
    owner.config.fidelity.bases = OffsetBases::Dc;
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let checkpoint = folder.path().join("checkpoint.safetensors");
    let first = embed(&gpu, &owner, Some(&checkpoint));
    assert!(first.sh_coeffs != owner.model.gaussians.sh_coeffs, "something was written");
    assert_same(&owner, &first, &embed(&gpu, &owner, None), "a second run");
    assert_same(&owner, &first, &resume(&gpu, &owner, &checkpoint), "a resumed run");
    assert_eq!(moved(&owner, &first)[1], 0, "no coefficient above DC moves by a bit");
}

#[test]
fn a_scene_without_higher_coefficients_takes_no_room_for_them() {
    let Some(gpu) = device() else { return };
    let mut owner = Owner::new(&gpu);
    owner.model.gaussians.sh_degree = 0;
    let mut of = |bases| {
        owner.config.fidelity.bases = bases;
        embed(&gpu, &owner, None)
    };
    let (dc, all) = (of(OffsetBases::Dc), of(OffsetBases::All));
    assert_same(&owner, &dc, &all, "all there are");
    assert_ne!(dc.sh_coeffs, owner.model.gaussians.sh_coeffs, "something was written");
    // Offsets of that embedding, as a checkpoint has them.
    let mut embedding = Embedding::prepare(owner.subject(&gpu), owner.config.clone()).expect("prepares");
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("checkpoint.safetensors");
    embedding.step().expect("steps");
    embedding.save(&path).expect("saves");
    let shape = TensorFile::read(&path).expect("a checkpoint").tensors["offsets.param"].shape.clone();
    assert_eq!(shape.iter().product::<usize>(), owner.model.gaussians.len() * OffsetBases::Dc.floats(), "DC alone");
}

/// Coefficients of an embedding whose bits differ from the original's: DC terms, others.
fn moved(owner: &Owner, embedded: &Embedded) -> [usize; 2] {
    let mut moved = [0; 2];
    for (i, (h, m)) in owner.model.gaussians.sh_coeffs.iter().zip(&embedded.sh_coeffs).enumerate() {
        moved[usize::from(i % 48 >= 3)] += usize::from(h.to_bits() != m.to_bits());
    }
    moved
}

#[test]
fn offsets_on_all_coefficients_move_resume_deliver_and_can_be_undone() {
    let Some(gpu) = device() else { return };
    let mut owner = Owner::new(&gpu);
    owner.config.fidelity.bases = OffsetBases::All;
    // What is written is what was embedded, and nothing besides.
    owner.config.fidelity.chips_db = 0.0;
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let checkpoint = folder.path().join("checkpoint.safetensors");
    let embedded = embed(&gpu, &owner, Some(&checkpoint));
    assert_same(&owner, &embedded, &resume(&gpu, &owner, &checkpoint), "a resumed run");
    let [dc, rest] = moved(&owner, &embedded);
    assert!(dc > 0 && rest > dc, "both groups move: {dc} and {rest}");
    let exist = 3 * (owner.model.gaussians.sh_degree + 1).pow(2) as usize;
    assert!(embedded.sh_coeffs.chunks(48).all(|row| row[exist..].iter().all(|v| *v == 0.0)), "none above the degree");

    let out = folder.path().join("out");
    owner.deliver(&gpu, &embedded, &out);
    let (original, marked) = (bytes(&owner.scene.path().join(PLY)), bytes(&out.join(MARKED).join(PLY)));
    assert_only_colour_changed(&original, &marked);
    let delivered = Model::open(&out.join(MARKED)).expect("the marked model opens");
    assert!(delivered.gaussians.sh_coeffs == embedded.sh_coeffs, "every coefficient is written");
    let receipt = Receipt::read(&out.join(PRIVATE).join(RECEIPT)).expect("the receipt reads");
    assert_eq!(receipt.body.settings["config"]["fidelity"]["bases"], "all", "the receipt names the coefficients");
    let restored = folder.path().join("restored");
    let undo_file = out.join(PRIVATE).join(UNDO);
    undo::restore(&out.join(MARKED), &undo_file, &restored, Existing::Refuse).expect("restores");
    assert!(bytes(&restored.join(PLY)) == original, "the original, byte for byte");
}

#[test]
fn impossible_weights_and_rates_are_refused() {
    let fine = EmbedConfig::new(Profile::Draft, ExtractorMode::Joint);
    fine.validate().expect("the profile is possible");
    let joint = |change: &dyn Fn(&mut JointConfig)| {
        fine.clone().with(|c| change(c.extractor.joint_mut().expect("it is joint")))
    };
    let untrainable = joint(&|joint| joint.tmsd = TmsdConfig::colour_map_only());
    let error = untrainable.validate().expect_err("joint trains the network").to_string();
    assert!(error.contains("TMSD depth"), "{error}");
    for bad in [-1.0, f32::NAN, f32::INFINITY] {
        for (name, config) in [
            ("lambda_msg", fine.clone().with(|c| c.objective.lambda_msg = bad)),
            ("lambda_recon", fine.clone().with(|c| c.objective.lambda_recon = bad)),
            ("lambda_ssim", fine.clone().with(|c| c.objective.lambda_ssim = bad)),
            ("lambda_offset", fine.clone().with(|c| c.objective.lambda_offset = bad)),
            ("lambda_control", joint(&|joint| joint.lambda_control = bad)),
            ("lr_dc", fine.clone().with(|c| c.optimiser.lr_dc = bad)),
            ("lr_rest_share", fine.clone().with(|c| c.optimiser.lr_rest_share = bad)),
        ] {
            let error = config.validate().expect_err("an impossible number");
            assert!(matches!(&error, EngineError::Usage { what, .. } if what == name), "{error}");
        }
    }
}

/// What every step of an embedding reports.
fn reports(gpu: &Gpu, owner: &Owner, config: EmbedConfig) -> Vec<StepReport> {
    let mut embedding = Embedding::prepare(owner.subject(gpu), config).expect("prepares");
    std::iter::from_fn(|| embedding.step().expect("steps")).collect()
}

#[test]
fn the_papers_weights_train_and_ssim_reaches_the_offsets() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    // One clip, and a hold that never binds: what is left is the paper's weighted sum.
    let paper = owner.config.clone().with(|c| {
        c.optimiser.steps = 8;
        c.views.clips = 1;
        c.fidelity.bases = OffsetBases::All;
        c.optimiser.lr_dc = 5e-3;
        c.objective.margin = 0.0;
        c.fidelity.target_psnr = 20.0;
        c.fidelity.start_psnr = 20.0;
        c.objective.lambda_msg = 0.03;
        c.objective.lambda_recon = 1.0;
        c.objective.lambda_ssim = 0.2;
        c.objective.lambda_offset = 10.0;
    });
    let trained = reports(&gpu, &owner, paper.clone());
    let totals: Vec<f32> = trained.iter().map(|r| r.total).collect();
    assert!(totals.iter().all(|t| t.is_finite()), "{totals:?}");
    assert!(trained.iter().skip(1).all(|r| r.recon > 0.0 && r.offset > 0.0), "every loss is there: {trained:?}");
    assert!(totals.iter().any(|total| *total < totals[0]), "the sum falls: {totals:?}");

    // SSIM alone against the message: the more it weighs, the less the picture changes.
    let ssim = |lambda_recon| {
        let config = paper.clone().with(|c| {
            c.objective.lambda_recon = lambda_recon;
            c.objective.lambda_ssim = 1.0;
            c.objective.lambda_offset = 0.0;
        });
        reports(&gpu, &owner, config).pop().expect("a last step").recon
    };
    let (free, held) = (ssim(1e-6), ssim(300.0));
    assert!(held < 0.5 * free, "1 - SSIM: {held} with its weight, {free} next to none");
}

#[test]
fn a_delivery_without_r_changes_colours_only_verifies_and_can_be_undone() {
    deliver_and_verify(ExtractorMode::None);
}

#[test]
fn a_delivery_of_general_changes_colours_only_verifies_and_can_be_undone() {
    deliver_and_verify(ExtractorMode::Pretrained);
}

#[test]
fn a_delivery_of_blind_changes_colours_only_verifies_and_can_be_undone() {
    deliver_and_verify(ExtractorMode::Blind);
}

#[test]
fn a_delivery_of_joint_changes_colours_only_verifies_and_can_be_undone() {
    deliver_and_verify(ExtractorMode::Joint);
}

/// The whole way of one mode.
fn deliver_and_verify(mode: ExtractorMode) {
    let Some(gpu) = device() else { return };
    let mut owner = Owner::new(&gpu);
    owner.config = owner.config_of(mode).with_probes(BITS as usize).with(|c| {
        let usual = EmbedConfig::new(Profile::Draft, mode).extractor.calibration().cloned();
        if let (Some(own), Some(usual)) = (c.extractor.calibration_mut(), usual) {
            own.copies = usual.copies;
        }
        c.optimiser.steps = 1;
    });
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let out = folder.path().join("out");
    let embedded = embed(&gpu, &owner, None);
    owner.deliver(&gpu, &embedded, &out);
    let (input, marked, private) = (owner.scene.path(), out.join(MARKED), out.join(PRIVATE));
    // The camera file is the demonstration's; it lies beside the model and goes with it.
    assert_eq!(files_below(&marked), files_below(input), "the same files");
    for file in files_below(input).iter().filter(|f| *f != Path::new(PLY)) {
        assert!(bytes(&marked.join(file)) == bytes(&input.join(file)), "{} is copied", file.display());
    }
    let original = bytes(&input.join(PLY));
    assert_only_colour_changed(&original, &bytes(&marked.join(PLY)));

    assert_eq!(files_below(&private), [EXTRACTOR, RECEIPT, UNDO].map(PathBuf::from), "the private files");
    let written = ExtractorWeights::read(&private.join(EXTRACTOR), &owner.key).expect("the extractor reads");
    assert_eq!(written, embedded.extractor, "it is the one that was trained with");
    assert_eq!((written.mode, written.tmsd.is_none()), (mode, mode == ExtractorMode::None), "R of the mode");
    let path = private.join(RECEIPT);
    let mut receipt = Receipt::read(&path).expect("the receipt reads");
    receipt.verify_commitment(&path).expect("the commitment holds");
    assert!(receipt.commits_to(&owner.message, &owner.key.prf()), "to this message");
    assert!(!receipt.commits_to(&owner.message.inverted(), &owner.key.prf()), "and no other");
    receipt.body.promise.num_bits += 1;
    receipt.verify_commitment(&path).expect_err("a changed receipt");

    let restored = folder.path().join("restored");
    undo::restore(&marked, &private.join(UNDO), &restored, Existing::Refuse).expect("restores");
    assert!(bytes(&restored.join(PLY)) == original, "the original, byte for byte");
    let refused = undo::restore(input, &private.join(UNDO), &folder.path().join("no"), Existing::Refuse);
    assert_eq!(refused.expect_err("an unmarked model").exit_code(), 65, "exit code");
    assert!(!folder.path().join("no").exists(), "nothing is written");
    verify(&gpu, &owner, &out);
}

fn inputs_of(film: &Path) -> VerifyInputs {
    VerifyInputs { suspects: vec![Suspect::Video(film.to_owned())], ..VerifyInputs::default() }
}

/// Whether a p-value was computed; else it is a bound by what controls did.
fn is_exact(p_value: PStatement) -> bool {
    match p_value {
        PStatement::Searched { .. } => panic!("nothing was searched"),
        PStatement::NotCommitted { .. } => panic!("the receipt binds its reader"),
        PStatement::Exact { matches, soft_score } => {
            assert!((0.0..=1.0).contains(&matches) && (0.0..=1.0).contains(&soft_score), "{matches}, {soft_score}");
            true
        }
        PStatement::Empirical { bound, .. } => {
            assert!((0.0..=1.0).contains(&bound), "{bound}");
            false
        }
    }
}

/// Reads the mark from frames and, of one mode, from video.
fn verify(gpu: &Gpu, owner: &Owner, out: &Path) {
    let receipt = out.join(PRIVATE).join(RECEIPT);
    let message = owner.message;
    let request = VerifyRequest {
        device: gpu,
        clip: &owner.clip,
        key: &owner.key,
        sought: Some(Sought::Message(message)),
        receipt: &receipt,
        pretrained: None,
        original: Some(&owner.model),
        trusted_clip: None,
        claims: NonZeroU32::MIN,
        cache: &VerifyCache::default(),
    };
    let extractor = TensorFile::read(&request.extractor_path()).expect("beside the receipt");
    let is_framed = extractor.tensors.contains_key("known_views.placements");
    let mut suspects = vec![out.join("preview")];
    if owner.config.mode() == ExtractorMode::Blind && crate::support::has_ffmpeg() {
        let model = Model::open(&out.join(MARKED)).expect("the marked model opens");
        let frames: Vec<Frame> = render_frames(gpu, &model, &cameras()).expect("renders").concat();
        suspects.push(out.join("marked.mp4"));
        write_video(&suspects[1], &frames, &EncodeOptions::default()).expect("encodes");
    }
    for path in suspects {
        let inputs = inputs_of(&path);
        let report = request.verify(&inputs, &ReadOptions::default()).expect("verifies");
        assert_eq!(report.frames, 2, "frames of {}", path.display());
        let auto = VerifyInputs { guesses: "auto".parse().expect("a word"), ..inputs_of(&path) };
        let guessed = request.verify(&auto, &ReadOptions::default()).expect("verifies");
        let tried = if is_framed { 2 } else { 90 };
        assert_eq!(guessed.undone.map(|undone| undone.tried), Some(tried), "guesses that suit {}", path.display());
        let frames = read_clip(&path, &ReadOptions::default()).expect("decodes").frames().to_vec();
        let suspects = vec![Suspect::Frames { name: "in memory".to_owned(), frames }];
        let inputs_in_memory = VerifyInputs { suspects, ..VerifyInputs::default() };
        let in_memory = request.verify(&inputs_in_memory, &ReadOptions::default()).expect("verifies");
        assert_eq!(in_memory.evidence, report.evidence, "the same frames from memory");
        assert_eq!(in_memory.clips[0].name, "in memory", "told of by its name");
        let mut seen = Vec::new();
        let stopped = request.verify_observed(&inputs, &ReadOptions::default(), &mut |progress: Progress<'_>| {
            seen.push((progress.done, progress.total, progress.stage == path.display().to_string()));
            if progress.done == 2 { Err(EngineError::Stopped) } else { Ok(()) }
        });
        assert!(matches!(stopped, Err(EngineError::Stopped)), "whoever watches may stop");
        assert_eq!(seen, [(1, Some(2), true), (2, Some(2), true)], "frames as they are read");
        let exact = is_exact(report.evidence.p_value);
        assert_eq!(exact, owner.config.mode() != ExtractorMode::Joint, "joint alone has no exact p-value");
    }
    let other = VerifyRequest { sought: Some(Sought::Message(message.inverted())), ..request };
    let refused = other.verify(&VerifyInputs::default(), &ReadOptions::default()).expect_err("another message");
    assert!(matches!(&refused, EngineError::BadData { field, .. } if field == "message_mac"), "{refused}");
}
