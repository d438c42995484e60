//! Presets: each draws, the reference as ever, and the command line knows all names.

use guard4d_engine::render::SceneRenderer;
use guard4d_engine::render::profile::{Profile, Viewer};
use guard4d_engine::render::storage::{Steps, Storage};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Gaussians, Model, Motion};
use guard4d_kernels::splat::rules::Framebuffer;

use super::super::psnr;
use crate::support::gpu::{Gpu, device};

/// Pixels of the embedded scene from its first camera.
fn drawn(gpu: &Gpu, model: &Model, profile: Option<Profile>) -> Vec<f32> {
    let (splats, motion) = (&model.gaussians, &model.motion);
    let renderer = match profile {
        None => SceneRenderer::new(gpu, splats, motion, [0.0; 3]),
        Some(profile) => SceneRenderer::by_profile(gpu, splats, motion, [0.0; 3], &profile),
    };
    let clips = DemoScene::unpack().expect("it unpacks").cameras((128, 128)).expect("cameras").clips();
    let mut pixels = Vec::new();
    let first = vec![vec![clips[0][0]]];
    let keep = |_: usize, _: &_, frame: &[f32]| {
        pixels.extend_from_slice(frame);
        Ok(())
    };
    renderer.expect("it fits").render_clips(&first, keep).expect("it is drawn");
    pixels
}

fn demo() -> Model {
    Model::open(DemoScene::unpack().expect("it unpacks").path()).expect("it opens")
}

#[test]
fn the_reference_draws_as_ever_and_the_others_differ() {
    let Some(gpu) = device() else { return };
    let model = demo();
    let plain = drawn(&gpu, &model, None);
    assert!(plain == drawn(&gpu, &model, Some(Viewer::Reference.profile())), "to the bit");
    for viewer in Viewer::ALL.into_iter().filter(|viewer| *viewer != Viewer::Reference) {
        let pixels = drawn(&gpu, &model, Some(viewer.profile()));
        assert!(pixels.iter().all(|v| v.is_finite()), "{}", viewer.name());
        let close_db = psnr(&pixels, &plain);
        // The same scene, in which no viewer's dilation changes more than the edges.
        assert!((20.0..90.0).contains(&close_db), "{}: {close_db:.1} dB", viewer.name());
    }
}

#[test]
fn viewers_in_browsers_blend_in_steps_of_eight_bits() {
    let Some(gpu) = device() else { return };
    let model = demo();
    for viewer in Viewer::ALL {
        let profile = viewer.profile();
        let pixels = drawn(&gpu, &model, Some(profile));
        let colours = || pixels.chunks(4).flat_map(|pixel| &pixel[..3]).map(|value| 255.0 * value);
        // Single precision, at 255.
        let is_stepped = colours().all(|steps| (steps - steps.round()).abs() < 1e-3);
        let expected = [Viewer::Spark, Viewer::PlayCanvas, Viewer::GaussianSplats3d].contains(&viewer);
        assert_eq!(is_stepped, expected, "{}", viewer.name());
        if !expected {
            continue;
        }
        let mut linear = profile;
        linear.rules.framebuffer = Framebuffer::Floats;
        let linear = drawn(&gpu, &model, Some(linear));
        let apart = colours().zip(linear.chunks(4).flat_map(|pixel| &pixel[..3]).map(|value| 255.0 * value));
        let rounded: Vec<f32> = apart.map(|(steps, value)| (steps - value.clamp(0.0, 255.0)).abs()).collect();
        let mean = rounded.iter().sum::<f32>() / rounded.len() as f32;
        // Rounding once leaves 0.25 at most; many times leaves more where there is something, and never much.
        assert!((0.05..2.0).contains(&mean), "{}: {mean} steps", viewer.name());
    }
}

#[test]
fn every_name_leads_to_its_viewer() {
    for viewer in Viewer::ALL {
        assert_eq!(viewer.name().parse(), Ok(viewer));
    }
    let refused = "sparks".parse::<Viewer>().expect_err("there is none of that name");
    assert!(refused.contains("reference, gsplat, gsplat-antialiased, spark"), "{refused}");
}

#[test]
fn compensated_splats_are_fainter_and_a_wider_dilation_blurs() {
    let Some(gpu) = device() else { return };
    let model = demo();
    let light = |profile| drawn(&gpu, &model, Some(profile)).chunks(4).map(|p| 1.0 - f64::from(p[3])).sum::<f64>();
    let kept = light(Viewer::Gsplat.profile());
    assert!(light(Viewer::GsplatAntialiased.profile()) < 0.99 * kept, "opacity falls");
    let mut wide = Viewer::Gsplat.profile();
    wide.rules.dilation = 2.0;
    assert!(light(wide) > 1.01 * kept, "coverage grows");
}

#[test]
fn every_moment_of_a_sequence_is_kept_alike() {
    let Some(gpu) = device() else { return };
    let splats = Gaussians { opacities: vec![0.3; 4], ..four_splats() };
    let storage = Storage { opacities: Steps::Below(2.0), ..Storage::EXACT };
    let profile = Profile { storage, ..Profile::REFERENCE };
    let motion = Motion::Sequence(vec![splats.clone(), splats.clone()]);
    let mut field = profile.upload(&gpu, &splats, &motion).expect("it fits");
    for time in [0.0, 1.0] {
        let read = field.at(time).expect("a moment").read().expect("read");
        // 0.57 is between the first step, a half, and the second; a half's logit is 0.
        assert_eq!(read.opacities, [0.0; 4], "at {time}");
    }
}

fn four_splats() -> Gaussians {
    Gaussians {
        means: vec![[0.0; 3]; 4],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 4],
        scales: vec![[-3.0; 3]; 4],
        opacities: vec![0.0; 4],
        sh_coeffs: vec![0.0; 4 * 48],
        sh_degree: 0,
    }
}
