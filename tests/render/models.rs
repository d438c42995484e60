//! Whole dynamic models: stress cases render cleanly, offsets act linearly, plans report their memory.

use std::sync::Arc;

use guard4d_engine::deform::DeformField;
use guard4d_engine::render::{Frame, FramePlan, Offsets, Prune, Renderer};
use guard4d_engine::scene::{CameraSet, ImageSize, Model};
use guard4d_kernels::shape::OffsetBases;

use super::{image, psnr};
use crate::support::gpu::{Gpu, device};
use crate::support::random::Random;
use crate::support::shared;

struct Setup {
    model: Model,
    field: DeformField,
    renderer: Renderer,
    plans: Vec<Arc<FramePlan>>,
}

/// Every `step`-th test camera of a model.
fn setup(gpu: &Gpu, name: &str, size: (u32, u32), step: usize) -> Option<Setup> {
    let folder = shared(&format!("data/models/{name}"))?;
    let model = Model::open(&folder).expect("the model opens");
    let size = ImageSize::new(size.0, size.1).expect("an image size");
    let cameras = CameraSet::open(&folder.join("transforms_test.json"), size).expect("the cameras open");
    let mut field = DeformField::new(gpu, &model.gaussians, model.deformation.as_ref()).expect("uploads");
    let mut renderer = Renderer::new(gpu).expect("renderer");
    let mut plans = Vec::new();
    for (_, camera, time) in cameras.entries().step_by(step) {
        let state = field.at(time).expect("deforms");
        plans.push(Arc::new(renderer.plan(&state, camera, Prune::Remove).expect("plans")));
    }
    Some(Setup { model, field, renderer, plans })
}

#[test]
fn stress_scene_renders_finite_images_that_pruning_does_not_change() {
    let Some(gpu) = device() else { return };
    let Some(mut s) = setup(&gpu, "stress4d", (101, 77), 5) else { return };
    let folder = shared("data/models/stress4d").expect("it was there a moment ago");
    let size = ImageSize::new(101, 77).expect("an image size");
    let cameras = CameraSet::open(&folder.join("transforms_test.json"), size).expect("the cameras open");
    for (plan, (_, camera, time)) in s.plans.iter().zip(cameras.entries().step_by(5)) {
        let pruned = image(&gpu, &mut s.renderer, plan, None, s.model.background).expect("renders");
        assert!(pruned.iter().all(|v| v.is_finite() && *v >= 0.0), "finite, colours not negative");
        assert!(pruned.chunks(4).all(|p| p[3] <= 1.0), "transmittance at most one");
        let state = s.field.at(time).expect("cached");
        let full = s.renderer.plan(&state, camera, Prune::Keep).expect("plans");
        let kept = image(&gpu, &mut s.renderer, &full, None, s.model.background).expect("renders");
        assert!(kept == pruned, "pruning changes no bit");
    }
}

#[test]
fn offsets_act_linearly_and_their_gradient_is_the_adjoint() {
    let Some(gpu) = device() else { return };
    let Some(mut s) = setup(&gpu, "fox", (160, 120), 13) else { return };
    let n = s.field.len();
    let mut random = Random(3);
    // Small enough that next to no colour crosses the clamp; those that do are below the tolerance.
    let offsets = random.vec_f32(48 * n, -1e-3, 1e-3);
    let data = gpu.buffer_from("offsets", &offsets).expect("buffer");
    let offsets_in = Offsets { data: &data, bases: OffsetBases::All };
    let frame_len = s.plans[0].frame_len();
    let g = random.vec_f32(frame_len * s.plans.len(), -1.0, 1.0);
    let mut marked = gpu.buffer("clip", g.len()).expect("buffer");
    let mut clean = gpu.buffer("clip", g.len()).expect("buffer");
    let v_clip = gpu.buffer_from("v_clip", &g).expect("buffer");
    let mut v_offsets = gpu.buffer("v_offsets", 48 * n).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let background = s.model.background;
    s.renderer.forward_clip(&mut rec, &s.plans, Some(offsets_in), background, &mut marked).expect("records");
    s.renderer.forward_clip(&mut rec, &s.plans, None, background, &mut clean).expect("records");
    s.renderer.backward_clip(&mut rec, &s.plans, offsets_in, &v_clip, &mut v_offsets).expect("records");
    rec.submit().expect("runs");
    let (marked, clean) = (marked.read().expect("read"), clean.read().expect("read"));
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum::<f64>();
    let change: Vec<f32> = marked.iter().zip(&clean).map(|(m, c)| m - c).collect();
    assert!(change.chunks(4).all(|p| p[3] == 0.0), "offsets never touch the transmittance");
    // <A B D, g> = <D, B^T A^T g>; the change is a difference of numbers of size one, so 1e-7 each.
    let (left, right) = (dot(&change, &g), dot(&offsets, &v_offsets.read().expect("read")));
    let norm = dot(&change, &change).sqrt() * dot(&g, &g).sqrt();
    assert!((left - right).abs() <= 1e-3 * norm, "{left} against {right}, norm {norm}");
    assert!(psnr(&marked, &clean) > 50.0, "a small mark is a small change: {} dB", psnr(&marked, &clean));
}

#[test]
fn the_same_step_twice_gives_the_same_bytes() {
    let Some(gpu) = device() else { return };
    let run = || {
        let mut s = setup(&gpu, "stress4d", (96, 96), 17)?;
        let data = gpu.buffer_from("offsets", &Random(5).vec_f32(48 * s.field.len(), -0.1, 0.1)).expect("buffer");
        let offsets = Offsets { data: &data, bases: OffsetBases::All };
        let mut clip = gpu.buffer("clip", s.plans[0].frame_len() * s.plans.len()).expect("buffer");
        let mut v_offsets = gpu.buffer("v_offsets", 48 * s.field.len()).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        s.renderer.forward_clip(&mut rec, &s.plans, Some(offsets), [0.0; 3], &mut clip).expect("records");
        s.renderer.backward_clip(&mut rec, &s.plans, offsets, &clip, &mut v_offsets).expect("records");
        rec.submit().expect("runs");
        Some((clip.read().expect("read"), v_offsets.read().expect("read")))
    };
    let Some(first) = run() else { return };
    assert!(Some(first) == run(), "image and gradient are the same to the bit");
}

#[test]
fn plans_report_memory_and_refuse_buffers_that_are_too_short() {
    let Some(gpu) = device() else { return };
    let Some(mut s) = setup(&gpu, "stress4d", (64, 64), 47) else { return };
    let plan = &s.plans[0];
    let (visible, isects) = (plan.num_visible(), plan.num_isects());
    assert!(visible > 0 && isects >= visible, "{visible} splats, {isects} pairs");
    // Records, directions and indices of a splat, two indices of a pair, and the tiles.
    assert!(plan.bytes() >= 56 * visible + 8 * isects, "{} bytes", plan.bytes());
    let rows = plan.visible_splats().expect("read");
    assert!(rows.len() == visible && rows.iter().all(|&r| (r as usize) < s.field.len()), "rows of the scene");
    let mut clip = gpu.buffer("clip", plan.frame_len() - 4).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let short = s.renderer.forward_clip(&mut rec, &s.plans[..1], None, [0.0; 3], &mut clip);
    assert!(short.is_err(), "a clip without room for the frame");
    let v_clip = gpu.buffer("v_clip", plan.frame_len()).expect("buffer");
    let mut v_offsets = gpu.buffer("v_offsets", 4).expect("buffer");
    let offsets = Offsets { data: s.field.sh_coeffs(), bases: OffsetBases::Dc };
    let frame = Frame { clip: &v_clip, index: 0 };
    assert!(s.renderer.backward(&mut rec, plan, offsets, frame, &mut v_offsets).is_err(), "a short gradient");
}
