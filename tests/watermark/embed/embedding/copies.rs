//! What the calibration makes of copies: it hears less of a brighter picture, and all that it hears is of unmarked
//! clips.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::media::Frame;
use guard4d_engine::picture::distortion::{Distortion, DistortionChain};
use guard4d_engine::release::evaluate::HeldOut;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile};
use guard4d_engine::watermark::extractor::reader::Reader;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;

use crate::support::gpu::{Gpu, device};
use crate::support::owner::{Owner, cameras};

fn copies(list: &[&str]) -> Vec<Distortion> {
    list.iter().map(|text| text.parse().expect("well written")).collect()
}

/// The extractor of 24 clips and as many random fields as leave a choice of directions, fitted with these copies.
fn fitted(gpu: &Gpu, owner: &Owner, calibration_copies: Vec<Distortion>) -> ExtractorWeights {
    let config = owner.config.clone().with(|c| {
        c.views.clips = 24;
        let calibration = c.extractor.calibration_mut().expect("blind has one");
        (calibration.probes, calibration.copies) = (48, calibration_copies);
    });
    Embedding::prepare(owner.subject(gpu), config).expect("prepares").fitted().clone()
}

/// Root mean square of the coordinates of some frames.
fn said(gpu: &Gpu, owner: &Owner, extractor: &ExtractorWeights, frames: &[Frame]) -> f64 {
    let mut reader = Reader::new(gpu, &owner.clip, &owner.key, extractor).expect("belongs to the key");
    let said = extractor.calibration.coordinates(&reader.look(frames).expect("reads").features);
    (said.iter().map(|z| z * z).sum::<f64>() / said.len() as f64).sqrt()
}

#[test]
fn a_brighter_copy_says_less_once_the_calibration_has_seen_some() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let clean = HeldOut::render(&gpu, &owner.model, &owner.model.gaussians.sh_coeffs, &cameras()).expect("films").clean;
    let size = (clean[0][0].width(), clean[0][0].height());
    let mut attack = DistortionChain::new(&gpu, size, &copies(&["brightness:1.3"]), 0).expect("an attack");
    let brighter: Vec<Frame> =
        (0..).zip(&clean[0]).map(|(i, frame)| attack.apply(frame, i).expect("of that size")).collect();
    let [without, with] = [copies(&[]), copies(&["brightness:0.7..1.3"])].map(|list| {
        let extractor = fitted(&gpu, &owner, list);
        assert_eq!(extractor.mode, ExtractorMode::Blind, "mode");
        (said(&gpu, &owner, &extractor, &brighter), said(&gpu, &owner, &extractor, &clean[0]))
    });
    // In the study a tenth is left; a scene of 64 px and 24 clips leaves more.
    assert!(with.0 < 0.5 * without.0, "brighter: {} with copies, {} without", with.0, without.0);
    // Content lies at one level by construction, single clips about it.
    assert!(with.1.is_finite() && without.1.is_finite() && with.1 < 2.0, "as it is: {with:?}, {without:?}");
}

#[test]
fn profiles_show_the_calibration_what_they_mean_to() {
    let of = |profile, mode| {
        EmbedConfig::new(profile, mode).extractor.calibration().map_or(Vec::new(), |c| c.copies.clone())
    };
    let default = copies(&["brightness:0.7..1.3"]);
    for profile in [Profile::Draft, Profile::Balanced] {
        assert_eq!(of(profile, ExtractorMode::Blind), default, "{profile:?}");
        for mode in [ExtractorMode::None, ExtractorMode::Joint] {
            assert!(of(profile, mode).is_empty(), "{profile:?}, {mode}: as the paper has it");
        }
    }
    assert!(of(Profile::Faithful, ExtractorMode::Blind).is_empty(), "the paper knows of no calibration");
}
