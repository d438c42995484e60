//! optim/neighbour_mean: GPU against the twin, and the twin against means by hand.

use guard4d_kernels::KernelError;
use guard4d_kernels::optim::neighbour_mean::{Neighbourhood, mix};
use guard4d_kernels::reference::optim::neighbour_mean as twin;

use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::random::Random;

fn on_gpu(gpu: &Gpu, rows: &[f32], neighbours: &[u32], row: usize, share: f32) -> Vec<f32> {
    let neighbours = gpu.buffer_from("neighbours", neighbours).expect("buffer");
    let rows = gpu.buffer_from("rows", rows).expect("buffer");
    let mut mixed = gpu.buffer_from("mixed", &vec![f32::NAN; rows.len()]).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    mix(&mut rec, &rows, &Neighbourhood { neighbours: &neighbours, row, share }, &mut mixed).expect("records");
    rec.submit().expect("runs");
    mixed.read().expect("reads")
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn rows_are_mixed_with_the_mean_of_their_neighbours() {
    let rows = [1.0f64, 10.0, 3.0, 30.0, 5.0, 50.0];
    let mixed = twin::mix(&rows, &[1, 2, 0, 2, 0, 1], 2, 0.5);
    assert_eq!(mixed, [2.5, 25.0, 3.0, 30.0, 3.5, 35.0], "half of each, half of the others' mean");
    assert_eq!(twin::mix(&rows, &[1, 2, 0], 2, 1.0), [3.0, 30.0, 5.0, 50.0, 1.0, 10.0], "the one neighbour alone");
    assert_eq!(twin::mix(&rows, &[1, 2, 0], 2, 0.0), rows, "no share of it");
    assert_eq!(twin::mix(&rows, &[3, 2, 0], 2, 0.5)[..2], [0.5, 5.0], "one that is not there is zeros");
    assert!(twin::mix::<f64>(&[], &[], 2, 0.5).is_empty(), "nothing");
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (n, k, row, share) in
        [(1, 1, 4, 0.5), (2, 1, 48, 0.25), (9, 8, 4, 1.0), (333, 8, 48, 0.5), (1001, 7, 4, 0.3), (67, 13, 12, 0.9)]
    {
        let mut random = Random(n as u64);
        let rows = random.vec_f32(n * row, -1.0, 1.0);
        let neighbours: Vec<u32> = (0..n * k).map(|_| random.below(n) as u32).collect();
        let got = on_gpu(&gpu, &rows, &neighbours, row, share);
        // The same products and sums in the same order: a rounding each, of values below 1, where a driver's differ.
        assert_close(&got, &twin::mix(&rows, &neighbours, row, share), k as f32 * f32::EPSILON, 0.0);
        let again = on_gpu(&gpu, &rows, &neighbours, row, share);
        assert!(bits(&got) == bits(&again), "{n} rows: the same bits again");
        assert!(
            bits(&on_gpu(&gpu, &rows, &neighbours, row, 0.0)) == bits(&rows),
            "{n} rows: a share of 0 changes none"
        );
    }
}

#[test]
fn poison_reaches_the_rows_beside_it_and_no_other() {
    let Some(gpu) = device() else { return };
    let (n, row) = (70, 4);
    let mut rows = vec![0.5f32; n * row];
    (rows[row], rows[3 * row + 1], rows[5 * row + 2]) = (f32::NAN, f32::INFINITY, 1e-40);
    // Each row's neighbours are the next two.
    let neighbours: Vec<u32> = (0..n).flat_map(|i| [1, 2].map(|step| ((i + step) % n) as u32)).collect();
    let got = on_gpu(&gpu, &rows, &neighbours, row, 0.5);
    for (i, v) in got.iter().enumerate() {
        let (splat, channel) = (i / row, i % row);
        match (splat, channel) {
            (0 | 1 | 69, 0) => assert!(v.is_nan(), "row {splat}: {v}"),
            (1..=3, 1) => assert!(v.is_infinite(), "row {splat}: {v}"),
            (3..=5, 2) => assert!(*v >= 0.25 && *v < 0.5, "row {splat}: {v}"),
            _ => assert!((v - 0.5).abs() <= 2.0 * f32::EPSILON, "row {splat}: {v}"),
        }
    }
    let far = [u32::MAX, 1, 0, 70];
    let got = on_gpu(&gpu, &[1.0; 8], &far, 4, 0.5);
    assert_close(&got, &[0.75, 0.75, 0.75, 0.75, 0.75, 0.75, 0.75, 0.75], 0.0, 0.0);
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let mut rec = gpu.recorder().expect("recorder");
    for (rows, neighbours, row, mixed, named) in [
        (24, 8, 6, 24, "rows"),
        (24, 8, 0, 24, "rows"),
        (26, 8, 4, 26, "rows"),
        (24, 7, 4, 24, "neighbours"),
        (24, 0, 4, 24, "neighbours"),
        (0, 1, 4, 0, "neighbours"),
        (24, 6, 4, 20, "mixed"),
    ] {
        let neighbours = gpu.buffer::<u32>("neighbours", neighbours).expect("buffer");
        let rows = gpu.buffer::<f32>("rows", rows).expect("buffer");
        let mut mixed = gpu.buffer::<f32>("mixed", mixed).expect("buffer");
        let refused = mix(&mut rec, &rows, &Neighbourhood { neighbours: &neighbours, row, share: 0.5 }, &mut mixed);
        assert!(matches!(refused, Err(KernelError::Shape { buffer, .. }) if buffer == named), "{named}: {refused:?}");
    }
    assert!(on_gpu(&gpu, &[], &[], 4, 0.5).is_empty(), "nothing to mix");
}
