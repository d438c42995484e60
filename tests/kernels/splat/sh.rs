//! splat/sh: the twin's gradient against differences, GPU against the twin.

use guard4d_kernels::reference::splat::sh as twin;
use guard4d_kernels::shape::OffsetBases;
use guard4d_kernels::splat::sh::{ShInputs, VisibleSplats, backward, forward};
use guard4d_kernels::{Buffer, Device, KernelError};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

fn unit_dirs(random: &mut Random, n: usize) -> Vec<f64> {
    let mut dirs = Vec::new();
    for _ in 0..n {
        let d = random.vec(3, -1.0, 1.0);
        let norm = d.iter().map(|v| v * v).sum::<f64>().sqrt();
        dirs.extend([d[0] / norm, d[1] / norm, d[2] / norm, 0.0]);
    }
    dirs
}

#[test]
fn basis_is_orthonormal_over_the_sphere() {
    // Midpoint rule in cos(theta) and phi: exact in phi, error (1/400)^2 in cos(theta).
    let (rows, columns) = (400, 32);
    let mut gram = [[0.0f64; 16]; 16];
    for row in 0..rows {
        let z = -1.0 + (f64::from(row) + 0.5) * 2.0 / f64::from(rows);
        for column in 0..columns {
            let phi = (f64::from(column) + 0.5) * std::f64::consts::TAU / f64::from(columns);
            let r = (1.0 - z * z).sqrt();
            let y = twin::basis([r * phi.cos(), r * phi.sin(), z], 3);
            let area = 4.0 * std::f64::consts::PI / f64::from(rows * columns);
            for i in 0..16 {
                for j in 0..16 {
                    gram[i][j] += y[i] * y[j] * area;
                }
            }
        }
    }
    for (i, row) in gram.iter().enumerate() {
        for (j, value) in row.iter().enumerate() {
            let want = f64::from(u8::from(i == j));
            assert!((value - want).abs() < 1e-3, "<Y{i}, Y{j}> = {value}");
        }
    }
}

#[test]
fn twin_gradient_agrees_with_differences() {
    let mut random = Random(5);
    let splats = [2, 0, 1];
    let dirs = unit_dirs(&mut random, 3);
    let coeffs = random.vec(48 * 4, -0.5, 0.5);
    let v = random.vec(12, -1.0, 1.0);
    for (degree, most) in (0..=3).flat_map(|degree| [(degree, f64::INFINITY), (degree, 0.6)]) {
        let colours = |c: &[f64]| twin::forward(c, &dirs, &splats, degree, most);
        let f = |c: &[f64]| colours(c).iter().zip(&v).map(|(a, b)| a * b).sum::<f64>();
        assert!(colours(&coeffs).iter().all(|c| *c <= most), "no colour is above {most}");
        let grad = twin::backward(&coeffs, &dirs, &splats, degree, most, &v);
        // Piecewise linear, and the data crosses no clamp within a step: only rounding remains.
        assert!(gradcheck(f, &coeffs, &grad) < 1e-8, "degree {degree}");
    }
}

/// What of rows `[16,3]` offsets have, laid out like them.
fn rows(all: &[f32], bases: OffsetBases) -> Vec<f32> {
    let mut rows = Vec::new();
    for row in all.chunks(48) {
        rows.extend(&row[..3 * bases.count()]);
        rows.resize(rows.len().next_multiple_of(4), 0.0);
    }
    rows
}

#[test]
fn gpu_follows_the_twin_for_every_degree_and_offset() {
    let Some(gpu) = device() else { return };
    for (visible, n) in [(1, 1), (37, 50), (300, 301)] {
        let mut random = Random(visible as u64);
        let dirs: Vec<f32> = unit_dirs(&mut random, visible).iter().map(|v| *v as f32).collect();
        let mut splats: Vec<usize> = (0..n).collect();
        (1..n).for_each(|i| splats.swap(i, random.below(i + 1)));
        splats.truncate(visible);
        // Large enough that a good part of the channels is clamped.
        let coeffs = random.vec_f32(48 * n, -0.6, 0.6);
        let all_offsets = random.vec_f32(48 * n, -0.2, 0.2);
        let v_colours = random.vec_f32(4 * visible, -1.0, 1.0);
        let all_already = random.vec_f32(48 * n, -1.0, 1.0);
        let buffer = |data: &[f32]| gpu.buffer_from("input", data).expect("buffer");
        let ids: Vec<u32> = splats.iter().map(|&s| s as u32).collect();
        let (dirs_gpu, ids_gpu) = (buffer(&dirs), gpu.buffer_from("ids", &ids).expect("buffer"));
        let (coeffs_gpu, v_gpu) = (buffer(&coeffs), buffer(&v_colours));
        let seen = VisibleSplats { dirs: &dirs_gpu, splat_from_visible: &ids_gpu, count: visible };
        for (degree, max_colour) in (0..=3).flat_map(|degree| [(degree, f32::INFINITY), (degree, 0.6)]) {
            for bases in [None, Some(OffsetBases::Dc), Some(OffsetBases::All)] {
                let count = bases.map_or(0, OffsetBases::count);
                let offset = |i: usize| if i % 48 < 3 * count { all_offsets[i] } else { 0.0 };
                let sum: Vec<f32> = coeffs.iter().enumerate().map(|(i, c)| c + offset(i)).collect();
                let offsets_gpu = buffer(&bases.map_or(vec![], |b| rows(&all_offsets, b)));
                let offsets = bases.map(|b| (&offsets_gpu, b));
                let sh = ShInputs { sh_coeffs: &coeffs_gpu, offsets, degree, max_colour };
                let mut colours = gpu.buffer("colours", 4 * visible).expect("buffer");
                let mut rec = gpu.recorder().expect("recorder");
                forward(&mut rec, &sh, &seen, &mut colours).expect("records");
                rec.submit().expect("runs");
                let want = twin::forward(&sum, &dirs, &splats, degree, max_colour);
                // 48 products of size one or less, each rounded twice.
                assert_close(&colours.read().expect("read"), &want, 1e-5, 0.0);
                let Some(bases) = bases else { continue };
                let already = rows(&all_already, bases);
                let mut v_offsets = buffer(&already);
                let mut rec = gpu.recorder().expect("recorder");
                backward(&mut rec, &sh, &seen, &v_gpu, &mut v_offsets).expect("records");
                rec.submit().expect("runs");
                let gradient = rows(&twin::backward(&sum, &dirs, &splats, degree, max_colour, &v_colours), bases);
                let want: Vec<f32> = already.iter().zip(gradient).map(|(a, g)| a + g).collect();
                // One product and one sum of size one.
                assert_close(&v_offsets.read().expect("read"), &want, 1e-6, 0.0);
            }
        }
    }
}

/// Colours and the gradient of the offsets, which starts from zero.
fn on_gpu(gpu: &Device, scene: &Scene, bases: OffsetBases, degree: u32) -> Vec<f32> {
    let buffer = |data: &[f32]| gpu.buffer_from("input", data).expect("buffer");
    let ids: Vec<u32> = scene.splats.iter().map(|&s| s as u32).collect();
    let (dirs, ids) = (buffer(&scene.dirs), gpu.buffer_from("ids", &ids).expect("buffer"));
    let (coeffs, offsets) = (buffer(&scene.coeffs), buffer(&rows(&scene.offsets, bases)));
    let v_colours = buffer(&scene.v_colours);
    let seen = VisibleSplats { dirs: &dirs, splat_from_visible: &ids, count: scene.splats.len() };
    let sh = ShInputs { sh_coeffs: &coeffs, offsets: Some((&offsets, bases)), degree, max_colour: f32::INFINITY };
    let mut colours = gpu.buffer("colours", scene.v_colours.len()).expect("buffer");
    let mut v_offsets = gpu.buffer("v_offsets", offsets.len()).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    forward(&mut rec, &sh, &seen, &mut colours).expect("records");
    backward(&mut rec, &sh, &seen, &v_colours, &mut v_offsets).expect("records");
    rec.submit().expect("runs");
    [colours.read().expect("read"), v_offsets.read().expect("read")].concat()
}

/// The same by the twin.
fn on_host(scene: &Scene, bases: OffsetBases, degree: u32) -> Vec<f32> {
    let offset = |i: usize| if i % 48 < 3 * bases.count() { scene.offsets[i] } else { 0.0 };
    let sum: Vec<f32> = scene.coeffs.iter().enumerate().map(|(i, c)| c + offset(i)).collect();
    let v_coeffs = twin::backward(&sum, &scene.dirs, scene.splats, degree, f32::INFINITY, &scene.v_colours);
    [twin::forward(&sum, &scene.dirs, scene.splats, degree, f32::INFINITY), rows(&v_coeffs, bases)].concat()
}

/// Inputs of both.
struct Scene<'a> {
    splats: &'a [usize],
    coeffs: Vec<f32>,
    offsets: Vec<f32>,
    dirs: Vec<f32>,
    v_colours: Vec<f32>,
}

#[test]
fn poison_shows_in_its_splat_and_channel_only() {
    let Some(gpu) = device() else { return };
    let splats = [2, 0];
    let mut random = Random(8);
    // Small coefficients: every colour is about a half, none is clamped.
    let small = random.vec_f32(2 * 144, -0.02, 0.02);
    let dirs: Vec<f32> = unit_dirs(&mut random, 2).iter().map(|v| *v as f32).collect();
    let clean = [small, dirs, random.vec_f32(8, 0.5, 1.0)].concat();
    let (offsets, dirs, v_colours) = (144, 288, 296);
    let part = |data: &[f32], from: usize, to: usize| data[from..to].to_vec();
    let scene = |data: &[f32]| Scene {
        splats: &splats,
        coeffs: part(data, 0, offsets),
        offsets: part(data, offsets, dirs),
        dirs: part(data, dirs, v_colours),
        v_colours: part(data, v_colours, v_colours + 8),
    };
    // Of splat 2: the DC term, a first term above degree 0, the last term; a term of the splat that is not seen.
    // Then the offset of the DC term, an axis of the direction, and the gradient of a colour and of the fourth channel.
    let places = [97, 99, 143, 49, offsets + 97, dirs + 1, v_colours + 1, v_colours + 3];
    for degree in 0..=3 {
        for bases in [OffsetBases::Dc, OffsetBases::All] {
            let on_gpu = |data: &[f32]| on_gpu(&gpu, &scene(data), bases, degree);
            let on_host = |data: &[f32]| on_host(&scene(data), bases, degree);
            // 48 products of size one or less, each rounded twice.
            let reach = poison::spread(&clean, &places, (1e-5, 0.0), on_gpu, on_host);
            let (one, last) = (usize::from(degree >= 1), usize::from(degree == 3));
            let terms = ((degree + 1) * (degree + 1)) as usize;
            let slopes = if bases == OffsetBases::Dc { 1 } else { terms };
            // All colours above degree 0, and the slopes along the 1, 4 and 7 bases of each degree that depend on y.
            let turned = 3 * one + if slopes == 1 { 0 } else { 3 * [0, 1, 5, 12][degree as usize] };
            assert_eq!(reach, [1, one, last, 0, 1, turned, slopes, 0], "degree {degree}, {bases:?}");
        }
    }
}

#[test]
fn wrong_shapes_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let none = Scene { splats: &[], coeffs: vec![], offsets: vec![], dirs: vec![], v_colours: vec![] };
    assert!(on_gpu(&gpu, &none, OffsetBases::All, 3).is_empty(), "no splat");
    let unseen = Scene { coeffs: vec![0.5; 48], offsets: vec![0.5; 48], ..none };
    assert_eq!(on_gpu(&gpu, &unseen, OffsetBases::All, 3), [0.0; 48], "no splat is seen, none has a gradient");

    let coeffs = gpu.buffer_from("coeffs", &[0.1f32; 96]).expect("buffer");
    let dirs = gpu.buffer_from("dirs", &[0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]).expect("buffer");
    let ids = gpu.buffer_from("ids", &[0u32, 1]).expect("buffer");
    let seen = VisibleSplats { dirs: &dirs, splat_from_visible: &ids, count: 2 };
    let sh = ShInputs { sh_coeffs: &coeffs, offsets: None, degree: 3, max_colour: f32::INFINITY };
    let mut colours = gpu.buffer("colours", 8).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let mut short: Buffer<f32> = gpu.buffer("colours", 4).expect("buffer");
    let error = forward(&mut rec, &sh, &seen, &mut short);
    assert!(matches!(error, Err(KernelError::Shape { buffer: "colours", .. })), "{error:?}");
    let error = forward(&mut rec, &ShInputs { degree: 4, ..sh }, &seen, &mut colours);
    assert!(matches!(error, Err(KernelError::Shape { buffer: "sh_coeffs", .. })), "{error:?}");
    let mut v_offsets = gpu.buffer("v_offsets", 96).expect("buffer");
    let error = backward(&mut rec, &sh, &seen, &colours, &mut v_offsets);
    assert!(matches!(error, Err(KernelError::Shape { buffer: "offsets", .. })), "{error:?}");
}
