//! splat/dc_colour: the twin's gradient against differences, GPU against the twin, and against `splat/sh`.

use guard4d_kernels::reference::splat::{dc_colour as twin, sh};
use guard4d_kernels::splat::dc_colour::{BaseColours, backward, forward};
use guard4d_kernels::{Device, KernelError};

use crate::support::close::{assert_close, largest};
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

/// Visible splats of a scene, out of order.
fn scattered(random: &mut Random, visible: usize, n: usize) -> Vec<usize> {
    let mut splats: Vec<usize> = (0..n).collect();
    (1..n).for_each(|i| splats.swap(i, random.below(i + 1)));
    splats.truncate(visible);
    splats
}

#[test]
fn twin_gradient_agrees_with_differences() {
    let mut random = Random(5);
    let splats = [2, 0, 1];
    let (base, offsets) = (random.vec(12, -0.5, 0.5), random.vec(16, -0.5, 0.5));
    let v = random.vec(12, -1.0, 1.0);
    for most in [f64::INFINITY, 0.2] {
        let f = |o: &[f64]| twin::forward(&base, o, &splats, most).iter().zip(&v).map(|(a, b)| a * b).sum::<f64>();
        // Piecewise linear, and the data crosses no clamp within a step: only rounding remains.
        assert!(gradcheck(f, &offsets, &twin::backward(&base, &offsets, &splats, most, &v)) < 1e-8);
    }
}

#[test]
fn with_the_base_of_a_view_it_is_the_colour_of_that_view() {
    let mut random = Random(6);
    let splats = scattered(&mut random, 5, 7);
    let (coeffs, offsets) = (random.vec(48 * 7, -4.0, 2.0), random.vec(4 * 7, -0.3, 0.3));
    let dirs: Vec<f64> = (0..5).flat_map(|i| [f64::from(i).cos(), f64::from(i).sin(), 0.0, 0.0]).collect();
    let mut marked = coeffs.clone();
    for (row, delta) in marked.chunks_exact_mut(48).zip(offsets.chunks_exact(4)) {
        row.iter_mut().zip(&delta[..3]).for_each(|(h, d)| *h += d);
    }
    let v = random.vec(20, -1.0, 1.0);
    for (degree, most) in [(0, f64::INFINITY), (1, 0.7), (2, f64::INFINITY), (3, 0.4)] {
        let base = sh::before_clamp(&coeffs, &dirs, &splats, degree);
        let got = twin::forward(&base, &offsets, &splats, most);
        let want = sh::forward(&marked, &dirs, &splats, degree, most);
        assert!(want.iter().filter(|c| **c == 0.0).count() > 5, "some channels are clamped");
        // Two orders of adding 16 numbers of size four in f64.
        let worst = largest(got.iter().zip(&want).map(|(a, b)| (a - b).abs()));
        assert!(worst < 1e-13, "degree {degree}: {worst}");
        let got = twin::backward(&base, &offsets, &splats, most, &v);
        let want = sh::backward(&marked, &dirs, &splats, degree, most, &v);
        for (a, b) in got.chunks_exact(4).zip(want.chunks_exact(48)) {
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-13), "degree {degree}: {a:?} {b:?}");
        }
    }
}

/// Colours with and without offsets, then the gradient of the offsets on top of `already`.
fn on_gpu(gpu: &Device, splats: &[usize], max_colour: f32, data: [&[f32]; 4]) -> Vec<f32> {
    let [base, offsets, v_colours, already] = data;
    let buffer = |data: &[f32]| gpu.buffer_from("input", data).expect("buffer");
    let ids: Vec<u32> = splats.iter().map(|&s| s as u32).collect();
    let (base, ids) = (buffer(base), gpu.buffer_from("ids", &ids).expect("buffer"));
    let (offsets, v_colours, mut v_offsets) = (buffer(offsets), buffer(v_colours), buffer(already));
    let seen = BaseColours { base: &base, splat_from_visible: &ids, count: splats.len(), max_colour };
    let colours = |_| gpu.buffer("colours", 4 * splats.len()).expect("buffer");
    let [mut marked, mut unmarked] = [0, 1].map(colours);
    let mut rec = gpu.recorder().expect("recorder");
    forward(&mut rec, &seen, Some(&offsets), &mut marked).expect("records");
    forward(&mut rec, &seen, None, &mut unmarked).expect("records");
    backward(&mut rec, &seen, &offsets, &v_colours, &mut v_offsets).expect("records");
    rec.submit().expect("runs");
    [marked, unmarked, v_offsets].map(|b| b.read().expect("read")).concat()
}

/// The same by the twin.
fn on_host(splats: &[usize], most: f32, [base, offsets, v_colours, already]: [&[f32]; 4]) -> Vec<f32> {
    let gradient = twin::backward(base, offsets, splats, most, v_colours);
    let unmarked = twin::forward(base, &vec![0.0; offsets.len()], splats, most);
    let sum = already.iter().zip(gradient).map(|(a, g)| a + g).collect();
    [twin::forward(base, offsets, splats, most), unmarked, sum].concat()
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (visible, n) in [(0, 0), (0, 3), (1, 1), (37, 50), (300, 301)] {
        let mut random = Random(visible as u64);
        let splats = scattered(&mut random, visible, n);
        // A good part of the channels is clamped.
        let (base, offsets) = (random.vec_f32(4 * visible, -0.5, 1.0), random.vec_f32(4 * n, -1.0, 1.0));
        let (v_colours, already) = (random.vec_f32(4 * visible, -1.0, 1.0), random.vec_f32(4 * n, -1.0, 1.0));
        let data = [&base, &offsets, &v_colours, &already].map(Vec::as_slice);
        for most in [f32::INFINITY, 0.4] {
            // One product and one sum of size one.
            assert_close(&on_gpu(&gpu, &splats, most, data), &on_host(&splats, most, data), 1e-6, 0.0);
        }
    }
}

#[test]
fn poison_shows_in_its_splat_and_channel_only() {
    let Some(gpu) = device() else { return };
    let splats = [2, 0];
    let mut random = Random(8);
    // Far from the clamp.
    let clean = [random.vec_f32(8, 0.4, 0.6), random.vec_f32(12, -0.1, 0.1), random.vec_f32(8, 0.5, 1.0)].concat();
    let parts = |data: &[f32]| [data[..8].to_vec(), data[8..20].to_vec(), data[20..28].to_vec(), vec![0.0; 12]];
    let gpu_side = |data: &[f32]| on_gpu(&gpu, &splats, f32::INFINITY, parts(data).each_ref().map(Vec::as_slice));
    let host_side = |data: &[f32]| on_host(&splats, f32::INFINITY, parts(data).each_ref().map(Vec::as_slice));
    // A base colour, its fourth channel; an offset of splat 2, of splat 1, which is not seen, a fourth channel; the
    // gradient of a colour and of a fourth channel. A NaN colour is not below zero, so that its gradient stays what it
    // was.
    let places = [1, 3, 8 + 9, 8 + 5, 8 + 11, 20 + 1, 20 + 3];
    // One product and one sum of size one.
    let reach = poison::spread(&clean, &places, (1e-6, 0.0), gpu_side, host_side);
    assert_eq!(reach, [2, 0, 1, 0, 0, 1, 0]);
}

#[test]
fn wrong_shapes_are_refused() {
    let Some(gpu) = device() else { return };
    let buffer = |len| gpu.buffer::<f32>("buffer", len).expect("buffer");
    let (short, right, ids) = (buffer(4), buffer(8), gpu.buffer_from("ids", &[0u32, 1]).expect("buffer"));
    let seen = |base| BaseColours { base, splat_from_visible: &ids, count: 2, max_colour: f32::INFINITY };
    let mut rec = gpu.recorder().expect("recorder");
    let error = forward(&mut rec, &seen(&short), None, &mut buffer(8));
    assert!(matches!(error, Err(KernelError::Shape { buffer: "base", .. })), "{error:?}");
    let error = forward(&mut rec, &seen(&right), None, &mut buffer(4));
    assert!(matches!(error, Err(KernelError::Shape { buffer: "colours", .. })), "{error:?}");
    let error = forward(&mut rec, &BaseColours { count: 3, ..seen(&right) }, None, &mut buffer(12));
    assert!(matches!(error, Err(KernelError::Shape { .. })), "{error:?}");
    let error = backward(&mut rec, &seen(&right), &right, &right, &mut buffer(4));
    assert!(matches!(error, Err(KernelError::Shape { buffer: "v_offsets", .. })), "{error:?}");
}
