//! scan/radix_sort: GPU against the twin.

use guard4d_kernels::KernelError;
use guard4d_kernels::reference::scan::radix_sort as twin;
use guard4d_kernels::scan::radix_sort::{SortPairs, sort};

use crate::support::gpu::{Gpu, device};
use crate::support::random::Random;

fn sorted(gpu: &Gpu, pairs: &[(u32, u32)], bits: u32) -> Vec<(u32, u32)> {
    let n = pairs.len();
    let mut scratch = SortPairs::new(gpu, "sort", n).expect("scratch");
    let (keys, values): (Vec<_>, Vec<_>) = pairs.iter().copied().unzip();
    scratch.keys.write_at(0, &keys).expect("write");
    scratch.values.write_at(0, &values).expect("write");
    let mut rec = gpu.recorder().expect("recorder");
    sort(&mut rec, &mut scratch, n, bits).expect("records");
    rec.submit().expect("runs");
    let (keys, values) = (scratch.keys.read().expect("read"), scratch.values.read().expect("read"));
    keys.into_iter().zip(values).take(n).collect()
}

#[test]
fn gpu_equals_the_twin_at_any_length_and_width() {
    let Some(gpu) = device() else { return };
    for (n, bits) in [(1, 32), (5, 32), (1000, 32), (2048, 4), (4097, 27), (40_000, 12), (300_001, 14), (3000, 1)] {
        let mut random = Random(n as u64);
        let limit = 1usize << bits;
        let pairs: Vec<_> = (0..n).map(|i| (random.below(limit) as u32, i as u32)).collect();
        assert_eq!(sorted(&gpu, &pairs, bits), twin::sort(&pairs, bits), "n = {n}, {bits} bits");
    }
}

#[test]
fn equal_keys_keep_their_order_and_extremes_sort() {
    let Some(gpu) = device() else { return };
    let mut random = Random(3);
    let pairs: Vec<_> = (0..5000).map(|i| ([0, u32::MAX, 1, u32::MAX - 1][random.below(4)], i)).collect();
    assert_eq!(sorted(&gpu, &pairs, 32), twin::sort(&pairs, 32));
    let same: Vec<_> = (0..5000).map(|i| (9, i)).collect();
    assert_eq!(sorted(&gpu, &same, 32), same);
    assert!(sorted(&gpu, &[], 32).is_empty(), "nothing to sort");
}

#[test]
fn more_pairs_than_the_capacity_are_refused() {
    let Some(gpu) = device() else { return };
    let mut scratch = SortPairs::new(&gpu, "sort", 8).expect("scratch");
    let mut rec = gpu.recorder().expect("recorder");
    let error = sort(&mut rec, &mut scratch, 9, 32);
    assert!(matches!(error, Err(KernelError::Shape { buffer: "keys", .. })), "{error:?}");
}
