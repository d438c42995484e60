//! An extractor that is fitted afterwards to an unmarked clip, and why it proves nothing.

use guard4d_engine::base::output::Existing;
use guard4d_engine::evidence::control::ControlKind;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::judgement::{PStatement, Verdict};
use guard4d_engine::evidence::reason::Reason;
use guard4d_engine::evidence::thresholds::Thresholds;
use guard4d_engine::media::Frame;
use guard4d_engine::release::evaluate::HeldOut;
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt};
use guard4d_engine::watermark::embed::Embedding;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_kernels::Device;
use guard4d_lab::cross_examination::{OtherScene, Witnesses, cross_examine};
use guard4d_lab::forgery::{ForgeConfig, Forgery, forge};

use crate::support::gpu::device;
use crate::support::owner::Owner;

/// Shortest messages that a control can contradict: 16 of 16 matches are 1.5e-5 by chance.
pub(crate) const BITS: u32 = 16;

/// Eight frames from one side.
fn cameras() -> CameraSet {
    let lens = Lens { fov_x_rad: 0.7, size: FrameSize::new(64, 64).expect("a size") };
    let orbit = Orbit { views: 1, elevation_deg: 20.0, look_at: LookAt::D_NERF, lens };
    let times: Vec<f32> = (0..8u8).map(|i| f32::from(i) / 8.0).collect();
    orbit.cameras().expect("an orbit").at_times(&times)
}

/// What an accuser starts from: the extractor of `joint` before its first step.
pub(crate) fn untrained(gpu: &Device, owner: &Owner) -> ExtractorWeights {
    let config = owner.config_of(ExtractorMode::Joint);
    Embedding::prepare(owner.subject(gpu), config).expect("prepares").fitted().clone()
}

/// A forgery that makes `clips` say the owner's message.
pub(crate) fn forged(gpu: &Device, owner: &Owner, clips: &[Vec<Frame>]) -> Forgery {
    let start = untrained(gpu, owner);
    let config = ForgeConfig { steps: 60, ..ForgeConfig::default() };
    forge(&owner.subject(gpu), &start, clips, &config).expect("forges")
}

#[test]
fn a_forged_extractor_makes_an_unmarked_clip_speak_and_convinces_nobody() {
    let Some(gpu) = device() else { return };
    let owner = Owner::with_bits(&gpu, BITS);
    let subject = owner.subject(&gpu);
    // Nothing was ever written into this model.
    let film = HeldOut::render(&gpu, &owner.model, &owner.model.gaussians.sh_coeffs, &cameras()).expect("films");
    let forgery = forged(&gpu, &owner, &film.clean);
    assert!(forgery.said.share() > 0.9, "{:?}, before {:?}", forgery.said, forgery.before);
    assert_eq!(forgery.extractor.mode, ExtractorMode::Joint, "whatever it was called");
    assert!(forgery.extractor.tmsd.as_ref().is_some_and(|t| t.is_trained()), "R was trained");
    assert_eq!(forgery.extractor.calibration, untrained(&gpu, &owner).calibration, "and nothing else");

    let scenes = [OtherScene { name: "other", clips: &film.marked }];
    let witnesses = Witnesses { scenes: &scenes, other_key: &owner.key, untrained: None };
    let said = cross_examine(&subject, &forgery.extractor, &film, &witnesses).expect("reads");
    assert!(matches!(said.evidence.p_value, PStatement::Empirical { .. }), "{:?}", said.evidence.p_value);
    assert_eq!(said.evidence.verdict, Verdict::Inconclusive, "{:?}", said.evidence.reasons);
    let fires = |kind: ControlKind| {
        let of_kind =
            |reason: &Reason| matches!(reason, Reason::ControlFires { control, .. } if *control == kind.to_string());
        said.evidence.reasons.iter().any(of_kind)
    };
    assert!(fires(ControlKind::CleanRender), "{:?}", said.evidence.reasons);
    // Here the other scene is the same one: a recital is heard wherever it is given.
    assert!(fires(ControlKind::UnrelatedClip), "{:?}", said.evidence.reasons);
}

#[test]
fn a_forged_extractor_cannot_call_itself_blind() {
    let Some(gpu) = device() else { return };
    let owner = Owner::with_bits(&gpu, BITS);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("extractor.safetensors");
    let start = untrained(&gpu, &owner);
    let mut trained = start.clone();
    // One weight is enough to print something.
    let last = trained.tmsd.as_mut().and_then(|t| t.layers.last_mut()).expect("joint has a network");
    last[0] = 1e-20;
    let read = |weights: &ExtractorWeights, mode| {
        ExtractorWeights { mode, ..weights.clone() }.write(&path, &owner.key, Existing::Replace).expect("writable");
        ExtractorWeights::read(&path, &owner.key)
    };
    assert_eq!(read(&trained, ExtractorMode::Joint).expect("what it is").tmsd, trained.tmsd);
    for mode in [ExtractorMode::Blind, ExtractorMode::Pretrained, ExtractorMode::None] {
        let refused = read(&trained, mode).expect_err("a network that may hold the message");
        assert!(refused.exit_code() == 65 && refused.to_string().contains("tmsd"), "{mode}: {refused}");
    }
    // A network that does nothing is no network; `none` has not even a colour map.
    read(&start, ExtractorMode::Blind).expect("never trained");
    read(&start, ExtractorMode::None).expect_err("a colour map");
}

#[test]
fn what_cannot_be_forged_with_is_refused() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let subject = owner.subject(&gpu);
    let blind = owner.prepare(&gpu).fitted().clone();
    let clips = [vec![Frame::new(32, 32, vec![90; 3 * 32 * 32]).expect("the length fits")]];
    let start = untrained(&gpu, &owner);
    let once = ForgeConfig { steps: 1, ..ForgeConfig::default() };
    let code = |start: &ExtractorWeights, clips: &[Vec<Frame>], config: ForgeConfig| {
        forge(&subject, start, clips, &config).map(|_| 0).unwrap_or_else(|e| e.exit_code())
    };
    assert_eq!(code(&start, &clips, once), 0, "one frame, one step");
    assert_eq!(code(&blind, &clips, once), 2, "no network");
    assert_eq!(code(&start, &[], once), 2, "no clip");
    assert_eq!(code(&start, &[vec![]], once), 2, "no frame");
    assert_eq!(code(&start, &clips, ForgeConfig { steps: 0, ..once }), 2, "no step");
    assert_eq!(code(&start, &clips, ForgeConfig { lr: f32::NAN, ..once }), 2, "no rate");
}

#[test]
fn a_rule_is_compared_in_everything_that_makes_present_easier() {
    let rule = Thresholds::default();
    assert!(rule.is_as_strict_as(&rule), "the same");
    let stricter = Thresholds { fpr: 1e-9, num_claims: 2, min_frames: 9, min_side_px: 65, control_level: 0.02, ..rule };
    assert!(stricter.is_as_strict_as(&rule) && !rule.is_as_strict_as(&stricter));
    let laxer = [
        Thresholds { fpr: 1e-5, ..rule },
        Thresholds { fpr: f64::NAN, ..rule },
        Thresholds { num_claims: 0, ..rule },
        Thresholds { min_frames: 7, ..rule },
        Thresholds { min_side_px: 63, ..rule },
        Thresholds { control_level: 0.001, ..rule },
        Thresholds { control_level: f64::NAN, ..rule },
    ];
    assert!(laxer.iter().all(|other| !other.is_as_strict_as(&rule)), "each of them");
}
