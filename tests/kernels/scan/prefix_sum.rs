//! scan/prefix_sum: GPU against the twin.

use guard4d_kernels::KernelError;
use guard4d_kernels::reference::scan::prefix_sum as twin;
use guard4d_kernels::scan::prefix_sum::{Scratch, exclusive};

use crate::support::gpu::device;
use crate::support::random::Random;

#[test]
fn gpu_equals_the_twin_at_any_length() {
    let Some(gpu) = device() else { return };
    let mut scratch = Scratch::new(&gpu, "sum").expect("scratch");
    // Around the texel, lane, chunk and block sizes; the last ones give every lane and every workgroup several chunks.
    for n in [
        1usize, 2, 3, 4, 5, 7, 8, 31, 1023, 1024, 1025, 2046, 2047, 2048, 8191, 9000, 16_384, 16_385, 600_001,
        2_500_003,
    ] {
        let mut random = Random(n as u64);
        let data: Vec<u32> = (0..n).map(|_| random.below(1000) as u32).collect();
        let mut padded = data.clone();
        // What follows the data must not count.
        padded.resize((n + 1).next_multiple_of(4), 77);
        let mut buffer = gpu.buffer_from("data", &padded).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        exclusive(&mut rec, &mut buffer, n, &mut scratch).expect("records");
        rec.submit().expect("runs");
        assert_eq!(buffer.read_range(0..n + 1).expect("read"), twin::exclusive(&data), "n = {n}");
    }
}

#[test]
fn sums_wrap_and_empty_data_has_total_zero() {
    let Some(gpu) = device() else { return };
    let mut scratch = Scratch::new(&gpu, "sum").expect("scratch");
    for (n, data) in [(3, [u32::MAX, 2, 5, 9]), (0, [6, 6, 6, 6])] {
        let mut buffer = gpu.buffer_from("data", &data).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        exclusive(&mut rec, &mut buffer, n, &mut scratch).expect("records");
        rec.submit().expect("runs");
        assert_eq!(buffer.read_range(0..n + 1).expect("read"), twin::exclusive(&data[..n]), "n = {n}");
    }
}

#[test]
fn a_buffer_without_room_for_the_total_is_refused() {
    let Some(gpu) = device() else { return };
    let mut scratch = Scratch::new(&gpu, "sum").expect("scratch");
    let mut buffer = gpu.buffer::<u32>("data", 8).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let error = exclusive(&mut rec, &mut buffer, 8, &mut scratch);
    assert!(matches!(error, Err(KernelError::Shape { buffer: "data", .. })), "{error:?}");
}
