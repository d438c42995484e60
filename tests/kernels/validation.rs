//! Whether the validation layers would be heard: faults on purpose.

use std::panic::{AssertUnwindSafe, catch_unwind};

use guard4d_kernels::image::quantize;
use guard4d_kernels::probe::mul_add::{self, Chains};
use guard4d_kernels::vk::take_validation_errors;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use crate::support::gpu::{is_required, own_device, unwatched_device, watched_device};
use crate::support::skipped;

#[test]
fn an_error_message_fails_the_test_that_caused_it() {
    let Some(gpu) = watched_device() else { return };
    gpu.say_error(c"heard once");
    assert_eq!(take_validation_errors(), ["heard once"]);
    assert_eq!(take_validation_errors(), [""; 0], "taken");

    gpu.say_error(c"fails the test");
    let panic = catch_unwind(AssertUnwindSafe(|| drop(gpu))).expect_err("the guard fails the test");
    let text = panic.downcast_ref::<String>().expect("a message");
    assert!(text.contains("validation errors:\nfails the test"), "{text}");
}

#[test]
fn messages_stay_on_the_thread_that_caused_them() {
    let Some(gpu) = watched_device() else { return };
    let device = Device::clone(&gpu);
    let theirs = std::thread::spawn(move || {
        device.say_error(c"another test's");
        take_validation_errors()
    });
    assert_eq!(theirs.join().expect("no panic"), ["another test's"]);
    assert_eq!(take_validation_errors(), [""; 0], "nothing is ours");
}

#[test]
fn a_device_that_is_to_be_left_alone_is_not_watched() {
    let (Some(watched), Some(gpu)) = (watched_device(), unwatched_device()) else { return };
    assert!(watched.is_validated() && !gpu.is_validated(), "only the other");
    // Where a layer watched, this would fail the test.
    gpu.say_error(c"to nobody");
    assert_eq!(take_validation_errors(), [""; 0], "nobody hears it");
}

/// Something to record; numbers are places in a row of buffers.
#[derive(Clone, Copy, Debug)]
enum Pass {
    Fill(usize),
    Copy(usize, usize),
    /// A kernel that reads a storage buffer.
    MulAdd(usize, usize),
    /// A kernel that reads through a texel view.
    Round(usize, usize),
}

/// Whether the recorder may put its barrier before the second pass.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Barrier {
    Kept,
    Forgotten,
}

impl Pass {
    fn record(self, rec: &mut Recorder, buffers: &mut [Buffer<f32>; 3]) -> Result<(), KernelError> {
        match self {
            Self::Fill(to) => rec.fill(&mut buffers[to], 1.0),
            Self::Copy(from, to) => {
                let [from, to] = pair(buffers, from, to);
                rec.copy(from, 0, to, 0, 64)?;
            }
            Self::MulAdd(from, to) => {
                let [from, to] = pair(buffers, from, to);
                mul_add::run(rec, Chains { runs: 1, scale: 0.5, shift: 1.0 }, from, to)?;
            }
            Self::Round(from, to) => {
                let [from, to] = pair(buffers, from, to);
                quantize::forward(rec, from, to)?;
            }
        }
        Ok(())
    }

    fn is_kernel(self) -> bool {
        matches!(self, Self::MulAdd(..) | Self::Round(..))
    }
}

fn pair(buffers: &mut [Buffer<f32>; 3], from: usize, to: usize) -> [&mut Buffer<f32>; 2] {
    buffers.get_disjoint_mut([from, to]).expect("two different places")
}

/// Validation errors of two passes in one submission.
fn errors_of(device: &Device, passes: [Pass; 2], barrier: Barrier) -> Vec<String> {
    let mut buffers = ["first", "second", "third"].map(|name| device.buffer::<f32>(name, 64).expect("buffer"));
    let mut rec = device.recorder().expect("recorder");
    for pass in passes {
        if barrier == Barrier::Forgotten {
            rec.forget_accesses();
        }
        pass.record(&mut rec, &mut buffers).expect("records");
    }
    rec.submit().expect("runs");
    take_validation_errors()
}

/// Two kernels that write the same buffer are not here: layers before 2026 let that pass.
#[test]
fn a_missing_barrier_is_reported_and_the_recorders_own_suffices() {
    use Pass::{Copy, Fill, MulAdd, Round};
    let Some(gpu) = watched_device() else { return };
    for (first, second, hazard) in [
        (Copy(0, 1), Copy(1, 2), "READ-AFTER-WRITE"),
        (Copy(0, 1), Fill(0), "WRITE-AFTER-READ"),
        (Fill(0), Fill(0), "WRITE-AFTER-WRITE"),
        (Fill(0), MulAdd(0, 1), "READ-AFTER-WRITE"),
        (MulAdd(0, 1), Copy(2, 1), "WRITE-AFTER-WRITE"),
        (MulAdd(0, 1), MulAdd(1, 2), "READ-AFTER-WRITE"),
        (MulAdd(0, 1), Round(1, 2), "READ-AFTER-WRITE"),
        (Round(0, 1), MulAdd(2, 0), "WRITE-AFTER-READ"),
    ] {
        let passes = [first, second];
        assert_eq!(errors_of(&gpu, passes, Barrier::Kept), [""; 0], "{passes:?} with the recorder's barrier");
        let errors = errors_of(&gpu, passes, Barrier::Forgotten);
        // Layers from 2024 on follow what kernels touch only when a setting asks for it.
        if errors.is_empty() && passes.iter().any(|p| p.is_kernel()) && !is_required() {
            skipped("these validation layers do not follow what kernels touch");
            return;
        }
        // Older layers say "SYNC-HAZARD-READ-AFTER-WRITE", newer ones "READ_AFTER_WRITE hazard".
        let found = errors.iter().any(|e| e.to_lowercase().contains("hazard") && e.replace('_', "-").contains(hazard));
        assert!(found, "{passes:?} without a barrier: {errors:?}");
    }
}

#[test]
fn a_closed_device_leaves_nothing_behind() {
    let (Some(gpu), Some(own)) = (watched_device(), own_device()) else { return };
    assert_eq!(errors_of(&own, [Pass::Round(0, 1), Pass::Copy(1, 2)], Barrier::Kept), [""; 0], "all kinds of objects");
    let last = own.buffer::<u32>("outlives the guard", 4).expect("buffer");
    drop(own);
    drop(last);
    assert_eq!(take_validation_errors(), [""; 0], "the layers tell of what is destroyed too late or never");
    drop(gpu);
}
