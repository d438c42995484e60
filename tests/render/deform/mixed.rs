//! Moments that are mixed of those beside them.

use std::sync::Arc;

use guard4d_engine::render::deform::{DeformField, MixedField, SplatState};
use guard4d_engine::scene::camera::paths::USUAL_FOV_X_RAD;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{LookAt, Model, Motion};

use crate::support::close::assert_close;
use crate::support::golden;
use crate::support::gpu::{Gpu, device};

fn fields(gpu: &Gpu, model: &Model) -> (DeformField, MixedField) {
    let field = || DeformField::new(gpu, &model.gaussians, &model.motion).expect("uploads");
    (field(), MixedField::new(gpu, field()))
}

/// Means with opacities, log scales, quaternions and coefficients.
fn read(state: &SplatState) -> [Vec<f32>; 4] {
    let raw = state.raw();
    [raw.means, raw.scales, raw.quats, &**state.sh_coeffs()].map(|buffer| buffer.read().expect("read"))
}

#[test]
fn what_a_network_changes_is_mixed_of_the_moments_beside() {
    let Some(gpu) = device() else { return };
    // One that changes coefficients, and one that leaves them.
    for name in ["dynerf_like", "dnerf_like"] {
        let model = Model::open(&golden::model(name)).expect("the model opens");
        let (mut field, mut mixed) = fields(&gpu, &model);
        // Planes of six samples from -1 to 1 bend at 0.2 and 0.6, which are ends of fifths: each has twenty parts.
        assert_eq!(mixed.steps(), 50, "{name}");
        let parts = 2.0 * f64::from(mixed.steps());
        let known = |field: &mut DeformField, part: f64| read(&field.at((part / parts) as f32).expect("deforms"));
        assert!(
            read(&mixed.at(7.0 / parts).expect("mixes")) == known(&mut field, 7.0),
            "{name}: nothing is mixed there"
        );
        let (before, behind) = (known(&mut field, 7.0), known(&mut field, 8.0));
        assert!(before[0] != behind[0], "{name}: it moves");
        let between = read(&mixed.at(7.25 / parts).expect("mixes"));
        for ((before, behind), between) in before.iter().zip(&behind).zip(&between) {
            let want: Vec<f32> = before.iter().zip(behind).map(|(a, b)| a + 0.25 * (b - a)).collect();
            // Sums in another order.
            assert_close(between, &want, 1e-6, 1e-6);
        }
        let (early, late) = (mixed.at(0.1).expect("mixes"), mixed.at(0.9).expect("mixes"));
        assert_eq!(Arc::ptr_eq(early.sh_coeffs(), late.sh_coeffs()), name == "dnerf_like");
    }
}

#[test]
fn the_latest_mixed_moments_are_kept() {
    let Some(gpu) = device() else { return };
    let model = Model::open(&golden::model("dnerf_like")).expect("the model opens");
    let (_, mut mixed) = fields(&gpu, &model);
    let times = [0.111, 0.222, 0.333, 0.444];
    let states = times.map(|time| mixed.at(time).expect("mixes"));
    for (time, state) in times.iter().zip(&states) {
        assert!(Arc::ptr_eq(state, &mixed.at(*time).expect("mixes")), "{time} is kept");
    }
    mixed.at(0.555).expect("mixes");
    assert!(
        !Arc::ptr_eq(&states[0], &mixed.at(times[0]).expect("mixes")),
        "the one that was asked for longest ago is not"
    );
}

#[test]
fn between_two_moments_splats_are_where_the_network_has_them() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let radius = LookAt::of(&model, USUAL_FOV_X_RAD).radius * (USUAL_FOV_X_RAD / 2.0).tan();
    let (mut field, mut mixed) = fields(&gpu, &model);
    assert_eq!(mixed.steps(), 48, "of 25 samples twelve parts are in time");
    for time in [0.0417_f64, 0.2291, 0.5403, 0.8727, 0.9911] {
        let exact = field.at(time as f32).expect("deforms").read().expect("reads").means;
        // So many radii off that nine of ten splats are no farther.
        let off = |state: Arc<SplatState>| {
            let means = state.read().expect("reads").means;
            let apart = |(a, b): (&[f32; 3], &[f32; 3])| {
                a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt() / radius
            };
            let mut apart: Vec<f64> = means.iter().zip(&exact).map(apart).collect();
            apart.sort_by(f64::total_cmp);
            apart[apart.len() * 9 / 10]
        };
        let beside = ((time * 96.0).round() / 96.0) as f32;
        let (mixed, nearest) = (off(mixed.at(time).expect("mixes")), off(field.at(beside).expect("deforms")));
        // A tenth of a pixel where the radius is 160 px; 0.06 px are seen.
        assert!(mixed <= 0.1 / 160.0, "{time}: {mixed} radii");
        assert!(mixed < 0.5 * nearest, "{time}: {mixed} radii, and {nearest} at the moment beside");
    }
}

#[test]
fn what_needs_no_network_is_not_mixed() {
    let Some(gpu) = device() else { return };
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let model = Model::open(scene.path()).expect("the scene opens");
    let still = DeformField::new(&gpu, &model.gaussians, &Motion::Still).expect("uploads");
    let mut mixed = MixedField::new(&gpu, still);
    assert!(Arc::ptr_eq(&mixed.at(0.123).expect("still"), &mixed.at(0.9).expect("still")), "one state");
}
