//! What is said of a device that was lost.

use guard4d_engine::error::EngineError;
use guard4d_kernels::KernelError;
use guard4d_kernels::vk::last_finished;

use crate::support::gpu::device;

const PASSES: [&str; 3] = ["nn/matmul", "fill", "nn/matmul"];

#[test]
fn the_last_pass_with_a_timestamp_is_named() {
    for (available, want) in [
        ([0, 0, 0, 0], "none"),
        ([1, 0, 0, 0], "none"),
        ([1, 1, 0, 0], "`nn/matmul`, pass 1 of 3"),
        ([1, 1, 1, 0], "`fill`, pass 2 of 3"),
        ([1, u64::MAX, 2, 1], "`nn/matmul`, pass 3 of 3"),
        // The query of pass 2 is not there, so nothing is known of what came after it.
        ([1, 1, 0, 1], "`nn/matmul`, pass 1 of 3"),
    ] {
        assert_eq!(last_finished(&available, &PASSES), want, "{available:?}");
    }
    assert_eq!(last_finished(&[1], &[]), "none", "an empty submission");
    assert_eq!(last_finished(&[], &PASSES), "none", "no query at all");
}

#[test]
fn passes_without_a_timestamp_are_not_denied() {
    let far = last_finished(&[1, 1, 1], &PASSES);
    assert_eq!(far, "`fill`, pass 2 of 3, or one after it: later passes have no timestamp");
    assert_eq!(last_finished(&[1, 1, 0], &PASSES), "`nn/matmul`, pass 1 of 3", "the timed ones did not all finish");
}

#[test]
fn submissions_longer_than_the_query_pool_are_timed_as_far_as_it_goes() {
    let Some(gpu) = device() else { return };
    let mut buffer = gpu.buffer::<u32>("counted", 4).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    for value in 0..5000 {
        rec.fill(&mut buffer, value);
    }
    let timings = rec.submit().expect("runs");
    assert!((1..5000).contains(&timings.passes.len()), "{} passes are timed", timings.passes.len());
    assert_eq!(buffer.read().expect("read"), [4999; 4], "the untimed ones ran");
}

#[test]
fn a_lost_device_has_an_exit_code_and_names_the_pass() {
    let last_pass = last_finished(&[1, 1, 1, 0], &PASSES);
    let error = EngineError::from(KernelError::DeviceLost { last_pass });
    // docs/reference/exit-codes.md
    assert_eq!(error.exit_code(), 76);
    assert_eq!(error.to_string(), "the device was lost; last pass known to have finished: `fill`, pass 2 of 3");
}
