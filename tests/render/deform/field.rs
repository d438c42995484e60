//! Deformed splats against the goldens of real state dicts, the cache, and chunks.

use std::sync::Arc;

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::render::deform::{DeformField, SplatState};
use guard4d_engine::scene::{Gaussians, Model, Motion};

use crate::support::close::assert_close;
use crate::support::golden;
use crate::support::gpu::{Gpu, device};

const SPLATS: usize = 48;
const TIMES: [(&str, f32); 4] = [("t0.0", 0.0), ("t0.37", 0.37), ("t0.5", 0.5), ("t1.0", 1.0)];

fn read(state: &SplatState) -> [Vec<f32>; 3] {
    let raw = state.raw();
    [raw.means, raw.scales, raw.quats].map(|buffer| buffer.read().expect("read"))
}

fn field(gpu: &Gpu, model: &Model) -> DeformField {
    DeformField::new(gpu, &model.gaussians, &model.motion).expect("uploads")
}

fn columns(rows: &[f32], stride: usize, keep: std::ops::Range<usize>) -> Vec<f32> {
    rows.chunks(stride).flat_map(|row| row[keep.clone()].to_vec()).collect()
}

#[test]
fn every_golden_model_deforms_as_its_reference() {
    let Some(gpu) = device() else { return };
    for name in ["dnerf_like", "dynerf_like", "deep_applyrot"] {
        let folder = golden::model(name);
        let model = Model::open(&folder).expect("the model opens");
        let expected = TensorFile::read(&folder.join("expected.safetensors")).expect("the golden file opens");
        let mut field = field(&gpu, &model);
        for (key, time) in TIMES {
            let want = |what: &str, shape: &[usize]| {
                expected.floats(&format!("{key}.{what}"), shape).expect("a tensor of the golden").to_vec()
            };
            let state = field.at(time).expect("deforms");
            let [means, scales, quats] = read(&state);
            // The goldens' own tolerance for f32.
            let tolerance = 1e-5;
            assert_close(&columns(&means, 4, 0..3), &want("xyz", &[SPLATS, 3]), tolerance, 0.0);
            assert_close(&columns(&means, 4, 3..4), &want("opacity", &[SPLATS, 1]), tolerance, 0.0);
            assert_close(&columns(&scales, 4, 0..3), &want("scale", &[SPLATS, 3]), tolerance, 0.0);
            assert_close(&quats, &want("rot", &[SPLATS, 4]), tolerance, 0.0);
            let sh = state.sh_coeffs().read().expect("read");
            assert_close(&sh, &want("sh", &[SPLATS, 16, 3]), tolerance, 0.0);
        }
    }
}

/// `gaussians` repeated to at least `n` splats.
fn repeated(gaussians: &Gaussians, n: usize) -> Gaussians {
    let times = n.div_ceil(gaussians.len());
    Gaussians {
        means: gaussians.means.repeat(times),
        quats: gaussians.quats.repeat(times),
        scales: gaussians.scales.repeat(times),
        opacities: gaussians.opacities.repeat(times),
        sh_coeffs: gaussians.sh_coeffs.repeat(times),
        sh_degree: gaussians.sh_degree,
    }
}

#[test]
fn splats_beyond_one_chunk_are_all_deformed() {
    let Some(gpu) = device() else { return };
    let folder = golden::model("dynerf_like");
    let mut model = Model::open(&folder).expect("the model opens");
    let few = field(&gpu, &model).at(0.37).expect("deforms");
    model.gaussians = repeated(&model.gaussians, 20_000);
    let many = field(&gpu, &model).at(0.37).expect("deforms");
    for (few, many) in read(&few).iter().zip(&read(&many)) {
        assert!(many.chunks(few.len()).all(|part| part == &few[..]), "every repetition is the same to the bit");
    }
    let (few, many) = (few.sh_coeffs().read().expect("read"), many.sh_coeffs().read().expect("read"));
    assert!(many.chunks(few.len()).all(|part| part == &few[..]), "coefficients too");
}

#[test]
fn moments_are_cached_and_the_oldest_goes_first() {
    let Some(gpu) = device() else { return };
    let folder = golden::model("dnerf_like");
    let model = Model::open(&folder).expect("the model opens");
    let mut field = field(&gpu, &model).with_cached_times(2);
    let alone = field.bytes();
    let first = field.at(0.25).expect("deforms");
    assert!(Arc::ptr_eq(&first, &field.at(0.25).expect("cached")), "the second request costs nothing");
    assert!(Arc::ptr_eq(first.sh_coeffs(), field.sh_coeffs()), "coefficients are shared when they do not move");
    let one = field.bytes() - alone;
    field.at(0.5).expect("deforms");
    field.at(0.25).expect("cached");
    field.at(0.75).expect("deforms, 0.5 goes");
    assert!(Arc::ptr_eq(&first, &field.at(0.25).expect("cached")), "recently used ones stay");
    assert_eq!(field.bytes(), alone + 2 * one, "two moments are held");
}

#[test]
fn moments_are_kept_as_far_as_bytes_go_and_fewer_when_memory_is_short() {
    let Some(gpu) = device() else { return };
    let model = Model::open(&golden::model("dnerf_like")).expect("the model opens");
    let mut field = field(&gpu, &model).with_cached_times(1);
    field.at(0.5).expect("deforms");
    let one = field.cached_bytes();
    assert!(one > 0 && field.num_cached() == 1, "{one} bytes");
    let mut field = field.with_cached_bytes(2, 4 * one);
    let all = |field: &mut DeformField| (0..6).for_each(|i| _ = field.at(i as f32 / 8.0).expect("deforms"));
    all(&mut field);
    assert_eq!((field.num_cached(), field.cached_bytes()), (4, 4 * one), "four of six");
    assert!(field.save_memory(), "from four to two");
    all(&mut field);
    assert_eq!(field.num_cached(), 2);
    assert!(field.save_memory() && !field.save_memory(), "from two to one, and no further");
    all(&mut field);
    assert_eq!(field.num_cached(), 1);
    assert!(field.forget_times() && !field.forget_times(), "nothing is left to forget");
}

#[test]
fn a_static_or_empty_scene_is_the_same_at_any_time() {
    let Some(gpu) = device() else { return };
    let folder = golden::model("dnerf_like");
    let mut model = Model::open(&folder).expect("the model opens");
    let mut fixed = DeformField::new(&gpu, &model.gaussians, &Motion::Still).expect("uploads");
    assert!(Arc::ptr_eq(&fixed.at(0.1).expect("static"), fixed.canonical()), "no network, no motion");
    model.gaussians = Gaussians::default();
    let mut empty = field(&gpu, &model);
    assert!(empty.is_empty() && empty.at(0.3).expect("empty").is_empty(), "nothing to move");
}
