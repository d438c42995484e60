//! Whole dynamic models: stress cases render cleanly, offsets act linearly, plans report their memory.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use guard4d_engine::render::deform::DeformField;
use guard4d_engine::render::{Frame, FramePlan, Offsets, Prune, Renderer};
use guard4d_engine::scene::gaussians::SH_FLOATS;
use guard4d_engine::scene::{CameraSet, FrameSize, Model};
use guard4d_kernels::shape::OffsetBases;

use super::super::{Y_0, image};
use crate::support::close::{assert_close, largest};
use crate::support::gpu::{Gpu, device};
use crate::support::random::Random;
use crate::support::{repo, shared};

struct Setup {
    model: Model,
    field: DeformField,
    renderer: Renderer,
    plans: Vec<Arc<FramePlan>>,
}

/// The scene that every clone has.
fn demo() -> PathBuf {
    repo("engine/assets/demo-scene")
}

/// Every `step`-th test camera of a model, whose DC terms are raised by `lift`.
fn setup(gpu: &Gpu, folder: &Path, size: (u32, u32), step: usize, lift: f32) -> Setup {
    let mut model = Model::open(folder).expect("the model opens");
    for splat in model.gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS) {
        splat[..3].iter_mut().for_each(|dc| *dc += lift);
    }
    let size = FrameSize::new(size.0, size.1).expect("an image size");
    let cameras = CameraSet::open(&folder.join("transforms_test.json"), size).expect("the cameras open");
    let mut field = DeformField::new(gpu, &model.gaussians, &model.motion).expect("uploads");
    let mut renderer = Renderer::new(gpu).expect("renderer");
    let mut plans = Vec::new();
    for (_, camera, time) in cameras.entries().step_by(step) {
        let state = field.at(time).expect("deforms");
        plans.push(Arc::new(renderer.plan(&state, camera, Prune::Remove).expect("plans")));
    }
    Setup { model, field, renderer, plans }
}

#[test]
fn images_are_finite_and_pruning_does_not_change_them() {
    let Some(gpu) = device() else { return };
    // The second one is made of needles, specks, ties and floaters.
    for folder in [Some(demo()), shared("data/models/stress4d")].into_iter().flatten() {
        let mut s = setup(&gpu, &folder, (101, 77), 11, 0.0);
        let size = FrameSize::new(101, 77).expect("an image size");
        let cameras = CameraSet::open(&folder.join("transforms_test.json"), size).expect("the cameras open");
        for (plan, (_, camera, time)) in s.plans.iter().zip(cameras.entries().step_by(11)) {
            let pruned = image(&gpu, &mut s.renderer, plan, None, s.model.background).expect("renders");
            assert!(pruned.iter().all(|v| v.is_finite() && *v >= 0.0), "finite, colours not negative");
            assert!(pruned.chunks(4).all(|p| p[3] <= 1.0), "transmittance at most one");
            let state = s.field.at(time).expect("cached");
            let full = s.renderer.plan(&state, camera, Prune::Keep).expect("plans");
            let kept = image(&gpu, &mut s.renderer, &full, None, s.model.background).expect("renders");
            assert!(kept == pruned, "pruning changes no bit");
        }
    }
}

/// Root of the sum of all squared spherical harmonics up to degree 3, in any direction: sqrt(16 / 4π).
const Y_LENGTH: f32 = 4.0 * Y_0;
/// Added to every DC term; with offsets up to [`LARGEST`] it keeps all colours off their cut at zero.
const LIFT: f32 = 8.0;
/// Largest offset.
const LARGEST: f32 = 0.25;

/// Lowest colour that any splat can have in any direction, with `factor` times the offsets: by Cauchy and Schwarz a sum
/// over bases is at most [`Y_LENGTH`] times the coefficients' length.
fn lowest_colour(sh_coeffs: &[f32], offsets: &[f32], factor: f32) -> f32 {
    let splats = sh_coeffs.chunks_exact(SH_FLOATS).zip(offsets.chunks_exact(SH_FLOATS));
    let colours = splats.flat_map(|(sh, offset)| {
        (0..3).map(move |channel| {
            let length = |values: &[f32]| values.iter().skip(channel).step_by(3).map(|v| v * v).sum::<f32>().sqrt();
            0.5 + Y_0 * sh[channel] - Y_LENGTH * (length(&sh[3..]) + factor * length(offset))
        })
    });
    -largest(colours.map(|colour| -colour))
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum()
}

#[test]
fn offsets_act_linearly_and_their_gradient_is_the_adjoint() {
    let Some(gpu) = device() else { return };
    let mut s = setup(&gpu, &demo(), (160, 120), 13, LIFT);
    let offsets = Random(3).vec_f32(SH_FLOATS * s.field.len(), -LARGEST, LARGEST);
    let lowest = lowest_colour(&s.model.gaussians.sh_coeffs, &offsets, 2.0);
    assert!(lowest > 0.0, "no colour may be cut at zero: {lowest}");
    let twice: Vec<f32> = offsets.iter().map(|v| 2.0 * v).collect();
    let (data, twice) = (gpu.buffer_from("offsets", &offsets), gpu.buffer_from("offsets", &twice));
    let (data, twice) = (data.expect("buffer"), twice.expect("buffer"));
    let film = |offsets| {
        let mut clip = gpu.buffer("clip", s.plans[0].frame_len() * s.plans.len()).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        let offsets = Some(Offsets { data: offsets, bases: OffsetBases::All });
        s.renderer.forward_clip(&mut rec, &s.plans, offsets, s.model.background, &mut clip).expect("records");
        rec.submit().expect("runs");
        clip.read().expect("read")
    };
    let zero = gpu.buffer("offsets", data.len()).expect("buffer");
    let [clean, once, twice] = [&zero, &data, &twice].map(film);
    let change: Vec<f32> = once.iter().zip(&clean).map(|(o, c)| o - c).collect();
    assert!(change.chunks(4).all(|p| p[3] == 0.0), "offsets never touch the transmittance");
    let brightest = largest(clean.iter().copied());
    let most = largest(change.iter().map(|v| v.abs()));
    assert!(most > 0.2 && brightest < 6.0, "large offsets: {most}, on colours up to {brightest}");
    let doubled: Vec<f32> = change.iter().zip(&clean).map(|(d, c)| 2.0 * d + c).collect();
    // A pixel adds up tens of terms to at most 4, in each of three pictures: some forty roundings of 2^-23. Found:
    // 4e-6.
    assert_close(&twice, &doubled, 1e-5, 0.0);

    let v_clip = gpu.buffer_from("v_clip", &change).expect("buffer");
    let mut v_offsets = gpu.buffer("v_offsets", data.len()).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let offsets_in = Offsets { data: &data, bases: OffsetBases::All };
    s.renderer.backward_clip(&mut rec, &s.plans, offsets_in, &v_clip, &mut v_offsets).expect("records");
    rec.submit().expect("runs");
    // <B D, B D> = <D, B^T B D>, a sum of squares in which nothing cancels. A pixel's change carries 1e-5 of rounding
    // error, whose sign is random over 1e5 pixels. Found: 1e-7.
    let v_offsets = v_offsets.read().expect("read");
    let (left, right) = (dot(&change, &change), dot(&offsets, &v_offsets));
    let agrees = |right: f64| (left - right).abs() <= 1e-6 * left;
    assert!(agrees(right), "{left} against {right}");
    // The check must notice a gradient that is 1 % short, that is zero, or that lacks the DC terms or all others.
    let of = |keep: fn(usize) -> bool| {
        let kept: Vec<f32> =
            v_offsets.iter().enumerate().map(|(i, v)| if keep(i % SH_FLOATS) { *v } else { 0.0 }).collect();
        dot(&offsets, &kept)
    };
    for wrong in [0.99 * right, 0.0, of(|i| i >= 3), of(|i| i < 3)] {
        assert!(!agrees(wrong), "{wrong} is not {left}");
    }
}

#[test]
fn the_same_step_twice_gives_the_same_bytes() {
    let Some(gpu) = device() else { return };
    let run = || {
        let mut s = setup(&gpu, &demo(), (96, 96), 17, 0.0);
        let data =
            gpu.buffer_from("offsets", &Random(5).vec_f32(SH_FLOATS * s.field.len(), -0.1, 0.1)).expect("buffer");
        let offsets = Offsets { data: &data, bases: OffsetBases::All };
        let mut clip = gpu.buffer("clip", s.plans[0].frame_len() * s.plans.len()).expect("buffer");
        let mut v_offsets = gpu.buffer("v_offsets", SH_FLOATS * s.field.len()).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        s.renderer.forward_clip(&mut rec, &s.plans, Some(offsets), [0.0; 3], &mut clip).expect("records");
        s.renderer.backward_clip(&mut rec, &s.plans, offsets, &clip, &mut v_offsets).expect("records");
        rec.submit().expect("runs");
        (clip.read().expect("read"), v_offsets.read().expect("read"))
    };
    let first = run();
    assert!(first.1.iter().any(|v| *v != 0.0), "there is a gradient");
    assert!(first == run(), "image and gradient are the same to the bit");
}

#[test]
fn plans_report_memory_and_refuse_buffers_that_are_too_short() {
    let Some(gpu) = device() else { return };
    let mut s = setup(&gpu, &demo(), (64, 64), 47, 0.0);
    let plan = &s.plans[0];
    let (visible, isects) = (plan.num_visible(), plan.num_isects());
    assert!(visible > 0 && isects >= visible, "{visible} splats, {isects} pairs");
    // Records, colours and indices of a splat, both indices of a pair in a word, some more for the tiles.
    let least = 60 * visible + 4 * isects;
    assert!((least..least + 8 * 64 * 64).contains(&plan.bytes()), "{} bytes, {least} of lists", plan.bytes());
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

#[test]
fn a_fixed_view_gives_the_same_pictures_and_gradients_in_no_more_memory() {
    let Some(gpu) = device() else { return };
    let mut s = setup(&gpu, &demo(), (101, 77), 24, 0.0);
    let size = FrameSize::new(101, 77).expect("an image size");
    let cameras = CameraSet::open(&demo().join("transforms_test.json"), size).expect("the cameras open");
    let (_, camera, time) = cameras.entries().next().expect("a camera");
    let state = s.field.at(time).expect("deforms");
    let plan = s.plans[0].clone();
    let again = s.renderer.plan(&state, camera, Prune::Remove).expect("plans");
    let fixed = s.renderer.fix_view(again).expect("fixes");
    assert!(fixed.bytes() <= plan.bytes(), "{} bytes, {} before", fixed.bytes(), plan.bytes());
    assert_eq!(fixed.visible_splats().expect("reads"), plan.visible_splats().expect("reads"));
    // Large enough that many colours are clamped.
    let row = OffsetBases::Dc.floats();
    let values = Random(4).vec_f32(row * s.field.len(), -2.0, 2.0);
    let data = gpu.buffer_from("offsets", &values).expect("buffer");
    let offsets = Offsets { data: &data, bases: OffsetBases::Dc };
    let mut brightest = Vec::new();
    for offsets in [None, Some(offsets)] {
        let want = image(&gpu, &mut s.renderer, &plan, offsets, s.model.background).expect("renders");
        let got = image(&gpu, &mut s.renderer, &fixed, offsets, s.model.background).expect("renders");
        // Two orders of adding 16 terms of size one, then a mean of them.
        assert_close(&got, &want, 1e-5, 0.0);
        brightest.push(largest(want.iter().copied()));
    }
    let brightest = largest(brightest);
    assert!(brightest > 1.2, "the offsets show: {brightest}");
    let v_clip = gpu.buffer_from("v_clip", &Random(5).vec_f32(plan.frame_len(), -1.0, 1.0)).expect("buffer");
    let mut gradient = |plan: &FramePlan| {
        let mut v_offsets = gpu.buffer("v_offsets", data.len()).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        let frame = Frame { clip: &v_clip, index: 0 };
        s.renderer.backward(&mut rec, plan, offsets, frame, &mut v_offsets).expect("records");
        rec.submit().expect("runs");
        v_offsets.read().expect("read")
    };
    let (got, want) = (gradient(&fixed), gradient(&plan));
    // A colour within rounding of the clamp may fall on either side; the data has none.
    assert!(got == want, "the same colours pass, and the gradients are the same sums");
    assert!(want.iter().any(|v| *v != 0.0), "there is a gradient");

    let all = gpu.buffer("offsets", SH_FLOATS * s.field.len()).expect("buffer");
    let all = Offsets { data: &all, bases: OffsetBases::All };
    let refused = image(&gpu, &mut s.renderer, &fixed, Some(all), s.model.background).expect_err("no directions");
    assert!(refused.to_string().contains("`dirs`"), "{refused}");
}
