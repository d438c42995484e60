//! splat/hexplane: the twin on planes that are known functions, GPU against the twin.

use guard4d_kernels::reference::splat::hexplane as twin;
use guard4d_kernels::splat::hexplane::{Plane, Planes, forward};

use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::poison;
use crate::support::random::Random;

const AABB: [[f32; 3]; 2] = [[1.3, 1.2, 1.4], [-1.3, -1.1, -1.2]];

fn random_planes(random: &mut Random, channels: usize, resolution: [usize; 4], levels: usize) -> Vec<twin::Plane<f32>> {
    let mut planes = Vec::new();
    for level in 0..levels {
        let size = |axis: usize| if axis == 3 { resolution[3] } else { resolution[axis] << level };
        for [a, b] in [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]] {
            let (width, height) = (size(a), size(b));
            planes.push(twin::Plane { data: random.vec_f32(channels * width * height, -1.0, 1.0), width, height });
        }
    }
    planes
}

fn gpu_features(gpu: &Gpu, planes: &[twin::Plane<f32>], channels: usize, means: &[f32], time: f32) -> Vec<f32> {
    let borrowed: Vec<_> = planes.iter().map(|p| Plane { data: &p.data, width: p.width, height: p.height }).collect();
    let device_planes = Planes::new(gpu, &borrowed, channels, AABB).expect("planes");
    let means_gpu = gpu.buffer_from("means", means).expect("buffer");
    let row = device_planes.features();
    let mut features = gpu.buffer("features", means.len() / 4 * row).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    forward(&mut rec, &device_planes, &means_gpu, time, &mut features).expect("records");
    rec.submit().expect("runs");
    // Without the padding channels.
    let padded = channels.next_multiple_of(4);
    features.read().expect("read").chunks(padded).flat_map(|level| level[..channels].to_vec()).collect()
}

#[test]
fn twin_reads_the_flipped_box_and_the_upper_half_of_time() {
    // Each plane holds its first coordinate's index, or 1: the product shows one axis at a time.
    let ramp = |width: usize, height: usize| (0..width * height).map(|i| (i % width) as f64).collect::<Vec<_>>();
    let ones = |width: usize, height: usize| vec![1.0; width * height];
    let plane = |data: Vec<f64>, width, height| twin::Plane { data, width, height };
    let aabb = [[1.0; 3], [-1.0; 3]];
    let mut planes: Vec<_> = (0..6).map(|_| plane(ones(5, 5), 5, 5)).collect();
    planes[0] = plane(ramp(5, 5), 5, 5);
    let at = |planes: &[twin::Plane<f64>], x: f64, t: f64| twin::forward(planes, 1, &aabb, &[x, 0.0, 0.0, 0.0], t)[0];
    // Row 0 of the box is the maximum: x = 1 falls on index 0, x = -1 on the last, outside stays there.
    for (x, want) in [(1.0, 0.0), (-1.0, 4.0), (0.5, 1.0), (-7.0, 4.0), (3.0, 0.0)] {
        assert!((at(&planes, x, 0.0) - want).abs() < 1e-12, "x = {x}: {}", at(&planes, x, 0.0));
    }
    planes[0] = plane(ones(5, 5), 5, 5);
    // The zt plane varies along its height: t = 0 reads the middle row, t = 1 the last.
    planes[5] = plane((0..25).map(|i| f64::from(i / 5)).collect(), 5, 5);
    for (t, want) in [(0.0, 2.0), (0.5, 3.0), (1.0, 4.0)] {
        assert!((at(&planes, 0.0, t) - want).abs() < 1e-12, "t = {t}");
    }
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (n, channels, resolution, levels) in
        [(1, 4, [8, 8, 8, 6], 2), (300, 2, [6, 7, 9, 5], 3), (77, 6, [4, 5, 3, 2], 1), (10, 4, [1, 2, 1, 1], 1)]
    {
        let mut random = Random(n as u64);
        let planes = random_planes(&mut random, channels, resolution, levels);
        // Some means lie outside the box, some exactly on its corners.
        let mut means = random.vec_f32(4 * n, -1.6, 1.6);
        means[..3].copy_from_slice(&AABB[0]);
        for time in [0.0, 0.37, 1.0] {
            let want = twin::forward(&planes, channels, &AABB, &means, time);
            // Six samples of size one; the position has a few roundings on up to 32 samples per axis.
            assert_close(&gpu_features(&gpu, &planes, channels, &means, time), &want, 5e-5, 0.0);
        }
    }
}

#[test]
fn poison_reads_a_border_and_shows_where_its_sample_is_read() {
    let Some(gpu) = device() else { return };
    let (channels, resolution) = (4, [8, 8, 8, 6]);
    let planes = random_planes(&mut Random(1), channels, resolution, 1);
    let clean = Random(2).vec_f32(12, -1.0, 1.0);
    let on_gpu = |means: &[f32]| gpu_features(&gpu, &planes, channels, means, 0.5);
    let on_host = |means: &[f32]| twin::forward(&planes, channels, &AABB, means, 0.5);
    // As above. No position is a number that shows: NaN reads the first sample, infinities the ends.
    assert_eq!(poison::spread(&clean, &[0, 5, 10, 3], (5e-5, 0.0), on_gpu, on_host), [0; 4], "three axes, and none");

    let samples: Vec<f32> = planes.iter().flat_map(|p| p.data.clone()).collect();
    let with = |data: &[f32]| {
        let mut from = data.iter().copied();
        let fill = |p: &twin::Plane<f32>| twin::Plane { data: from.by_ref().take(p.data.len()).collect(), ..*p };
        planes.iter().map(fill).collect::<Vec<_>>()
    };
    let on_gpu = |data: &[f32]| gpu_features(&gpu, &with(data), channels, &clean, 0.5);
    let on_host = |data: &[f32]| twin::forward(&with(data), channels, &AABB, &clean, 0.5);
    // The first plane's sample at the lower neighbours of the first splat, in channel 2.
    let lower = |k: usize| ((clean[k] - AABB[0][k]) / (AABB[1][k] - AABB[0][k]) * 7.0).floor() as usize;
    let at = (2 * 8 + lower(1)) * 8 + lower(0);
    let reach = poison::spread(&samples, &[at], (5e-5, 0.0), on_gpu, on_host);
    assert!((1..=3).contains(&reach[0]), "its channel of the splats beside it: {reach:?}");
}

#[test]
fn wrong_planes_are_refused_and_no_splats_are_fine() {
    let Some(gpu) = device() else { return };
    let planes = random_planes(&mut Random(1), 4, [8, 8, 8, 6], 1);
    assert!(gpu_features(&gpu, &planes, 4, &[], 0.5).is_empty(), "no splat, no feature");
    let short = Plane { data: &[0.0; 5], width: 3, height: 2 };
    assert!(Planes::new(&gpu, &[short; 6], 1, AABB).is_err(), "too few values");
    let right = Plane { data: &[0.0; 6], width: 3, height: 2 };
    assert!(Planes::new(&gpu, &[right; 5], 1, AABB).is_err(), "five planes");
    assert!(Planes::new(&gpu, &[], 1, AABB).is_err(), "no plane");
}
