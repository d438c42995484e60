//! How a mark is spread over the splats: by their light.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::render::{FrameMut, Prune, Renderer};
use guard4d_engine::scene::gaussians::SH_FLOATS;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile, most_visible};

use crate::support::gpu::{Gpu, device};
use crate::support::owner::{BITS, Owner};

fn small(owner: &Owner) -> EmbedConfig {
    owner.config.clone().with(|c| {
        c.extractor.calibration_mut().expect("fitted").probes = BITS as usize;
        c.views.size_px = (32, 32);
    })
}

fn prepare<'a>(gpu: &'a Gpu, owner: &'a Owner, config: &EmbedConfig) -> Embedding<'a> {
    Embedding::prepare(owner.subject(gpu), config.clone()).expect("prepares")
}

#[test]
fn the_light_of_all_splats_is_what_covers_the_pixels() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let mut embedding = prepare(&gpu, &owner, &small(&owner));
    let weights = embedding.visibility().expect("measures");
    assert_eq!(weights.len(), owner.model.gaussians.len(), "one for each splat");
    assert!(weights.iter().all(|w| *w >= 0.0 && w.is_finite()), "light is not negative");
    let mut field = DeformField::new(&gpu, &owner.model.gaussians, &owner.model.motion).expect("field");
    let mut renderer = Renderer::new(&gpu).expect("renderer");
    let mut covered = 0.0;
    let mut image = gpu.buffer("image", 32 * 32 * 4).expect("buffer");
    for (camera, time) in embedding.training_shots().flatten() {
        let state = field.at(*time).expect("deforms");
        let plan = renderer.plan(&state, camera, Prune::Keep).expect("plans");
        let mut rec = gpu.recorder().expect("recorder");
        let frame = FrameMut { clip: &mut image, index: 0 };
        renderer.forward(&mut rec, &plan, None, [0.0; 3], frame).expect("records");
        rec.submit().expect("runs");
        covered += image.read().expect("reads").chunks_exact(4).map(|px| 1.0 - f64::from(px[3])).sum::<f64>();
    }
    let light: f64 = weights.iter().sum();
    // What all channels clamp to black at once is missing, and each of 16 frames' sums is rounded to single precision.
    assert!(light <= covered * (1.0 + 1e-5) && light > 0.98 * covered, "{light} of {covered} px");
}

#[test]
fn most_visible_are_the_fewest_splats_that_carry_the_share() {
    let weights = [1.0, 0.0, 6.0, 2.0, 1.0];
    assert_eq!(most_visible(&weights, 1.0), [true; 5], "all, seen or not");
    assert_eq!(most_visible(&weights, 0.5), [false, false, true, false, false]);
    assert_eq!(most_visible(&weights, 0.625), [false, false, true, true, false]);
    assert_eq!(most_visible(&weights, 0.85), [true, false, true, true, false], "the first of two equals");
    assert_eq!(most_visible(&weights, 0.999), [true, false, true, true, true], "none that is never seen");
    assert_eq!(most_visible(&[0.0; 2], 0.5), [false; 2], "nothing to see");
    assert_eq!(most_visible(&[], 0.5), [false; 0]);
}

#[test]
fn splats_beyond_the_share_keep_their_bits() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let config = small(&owner).with(|c| c.fidelity.visibility_share = 0.5);
    let mut embedding = prepare(&gpu, &owner, &config);
    let reached = most_visible(&embedding.visibility().expect("measures"), config.fidelity.visibility_share);
    let few = reached.iter().filter(|reached| **reached).count();
    assert!(few > 0 && 2 * few < reached.len(), "half of the light is of {few} of {} splats", reached.len());
    while embedding.step().expect("steps").is_some() {}
    let marked = embedding.finish().expect("finishes").sh_coeffs;
    let rows = marked.chunks_exact(SH_FLOATS).zip(owner.model.gaussians.sh_coeffs.chunks_exact(SH_FLOATS));
    let changed: Vec<bool> =
        rows.map(|(with, without)| with.iter().zip(without).any(|(a, b)| a.to_bits() != b.to_bits())).collect();
    let changed_beyond = changed.iter().zip(&reached).filter(|(changed, reached)| **changed && !**reached).count();
    assert_eq!(changed_beyond, 0, "splats changed beyond the share");
    // A splat may be seen in clips that none of the four steps took, or have no gradient.
    let changed = changed.iter().filter(|changed| **changed).count();
    assert!(2 * changed > few, "{changed} of {few} splats changed");
}

#[test]
fn impossible_shares_are_refused_and_settings_name_them() {
    let plain = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind);
    let said = serde_json::to_value(&plain).expect("JSON");
    assert_eq!(said["fidelity"]["visibility_share"], 1.0, "all: {said}");
    let half = plain.clone().with(|c| c.fidelity.visibility_share = 0.5);
    half.validate().expect("possible");
    assert_eq!(serde_json::to_value(&half).expect("JSON")["fidelity"]["visibility_share"], 0.5);
    for (share, what) in
        [(0.0, "visibility_share: 0"), (1.5, "visibility_share: 1.5"), (f32::NAN, "visibility_share: NaN")]
    {
        let refused =
            plain.clone().with(|c| c.fidelity.visibility_share = share).validate().expect_err(what).to_string();
        assert!(refused.contains(what), "{refused}");
    }
}
