//! Passes that are recorded once and replayed.

use std::time::Duration;

use guard4d_kernels::image::quantize;
use guard4d_kernels::probe::mul_add::{self, Chains};
use guard4d_kernels::vk::take_validation_errors;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder, Section};

use crate::support::gpu::{device, is_required, own_device, watched_device};
use crate::support::skipped;

const LEN: usize = 64;
/// x/2 + 1
const CHAIN: Chains = Chains { runs: 1, scale: 0.5, shift: 1.0 };

fn three(device: &Device) -> [Buffer<f32>; 3] {
    let values: Vec<f32> = (0..LEN).map(|i| i as f32).collect();
    ["first", "second", "third"].map(|name| device.buffer_from(name, &values).expect("buffer"))
}

/// first → second → third, with a barrier between, and a fill of the first that must wait for the pass that read it.
fn record(rec: &mut Recorder, [first, second, third]: &mut [Buffer<f32>; 3]) -> Result<(), KernelError> {
    mul_add::run(rec, CHAIN, first, second)?;
    quantize::forward(rec, second, third)?;
    rec.fill(first, 0.25);
    Ok(())
}

fn read(buffers: &[Buffer<f32>; 3]) -> [Vec<u32>; 3] {
    buffers.each_ref().map(bits)
}

fn bits(buffer: &Buffer<f32>) -> Vec<u32> {
    buffer.read().expect("reads").iter().map(|v| v.to_bits()).collect()
}

/// Submissions of [`record`], as often as asked in each, by `one`.
fn run(device: &Device, buffers: &mut [Buffer<f32>; 3], mut one: impl FnMut(&mut Recorder, &mut [Buffer<f32>; 3])) {
    for times in [1, 2, 1] {
        let mut rec = device.recorder().expect("recorder");
        for _ in 0..times {
            one(&mut rec, buffers);
        }
        let timings = rec.submit().expect("runs");
        let names: Vec<_> = timings.passes.iter().map(|p| p.name).collect();
        assert_eq!(names, ["probe/mul_add_run", "image/quantize_round", "fill"].repeat(times), "each pass has a time");
    }
}

#[test]
fn a_replay_does_what_was_recorded_pass_by_pass() {
    let Some(gpu) = device() else { return };
    let (mut anew, mut replayed) = (three(&gpu), three(&gpu));
    let before = read(&replayed);
    let section = gpu.section(|rec| record(rec, &mut replayed)).expect("records");
    assert_eq!(read(&replayed), before, "nothing runs while it is recorded");
    run(&gpu, &mut anew, |rec, buffers| record(rec, buffers).expect("records"));
    run(&gpu, &mut replayed, |rec, _| rec.replay(&section).expect("replays"));
    assert_ne!(read(&anew), before);
    assert_eq!(read(&anew), read(&replayed));
}

#[test]
fn what_a_section_touches_lives_as_long_as_it() {
    let Some(own) = own_device() else { return };
    let mut anew = three(&own);
    let mut rec = own.recorder().expect("recorder");
    record(&mut rec, &mut anew).expect("records");
    rec.submit().expect("runs");
    let [_, _, want] = read(&anew);
    let live = |device: &Device| device.memory_use().live_bytes;
    let kept = own.buffer::<f32>("kept", LEN).expect("buffer");
    let without = live(&own);
    let mut buffers = three(&own);
    let mut result = own.buffer::<f32>("result", LEN).expect("buffer");
    let section = own
        .section(|rec| {
            record(rec, &mut buffers)?;
            rec.copy(&buffers[2], 0, &mut result, 0, LEN)
        })
        .expect("records");
    let with = live(&own);
    drop(buffers);
    assert_eq!(live(&own), with, "the section holds them");
    let mut rec = own.recorder().expect("recorder");
    rec.replay(&section).expect("replays");
    drop(section);
    rec.submit().expect("runs what it alone still holds");
    assert_eq!(bits(&result), want, "what the passes leave when they are recorded anew");
    drop(result);
    assert_eq!(live(&own), without, "and lets go of them");
    drop((kept, anew, own));
    assert_eq!(take_validation_errors(), [""; 0], "nothing was destroyed too early or never");
}

/// A copy into the first buffer or out of the third, beside a section.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Neighbour {
    Before,
    After,
    /// The section itself, once more.
    Again,
}

/// Validation errors of a section next to a pass that it depends on or that depends on it.
fn errors_of(device: &Device, neighbour: Neighbour, forgets: bool) -> Vec<String> {
    let (mut buffers, mut other) = (three(device), device.buffer::<f32>("other", LEN).expect("buffer"));
    let section = device.section(|rec| record(rec, &mut buffers)).expect("records");
    let [first, _, third] = &mut buffers;
    let mut rec = device.recorder().expect("recorder");
    let forget = |rec: &mut Recorder| {
        if forgets {
            rec.forget_accesses()
        }
    };
    let replay = |rec: &mut Recorder, section: &Section| rec.replay(section).expect("replays");
    match neighbour {
        Neighbour::Before => {
            rec.copy(&other, 0, first, 0, LEN).expect("records");
            forget(&mut rec);
            replay(&mut rec, &section);
        }
        Neighbour::After => {
            replay(&mut rec, &section);
            forget(&mut rec);
            rec.copy(third, 0, &mut other, 0, LEN).expect("records");
        }
        Neighbour::Again => {
            replay(&mut rec, &section);
            forget(&mut rec);
            replay(&mut rec, &section);
        }
    }
    rec.submit().expect("runs");
    take_validation_errors()
}

#[test]
fn sections_are_ordered_with_what_stands_beside_them() {
    let Some(gpu) = watched_device() else { return };
    for neighbour in [Neighbour::Before, Neighbour::After, Neighbour::Again] {
        assert_eq!(errors_of(&gpu, neighbour, false), [""; 0], "{neighbour:?} with the recorder's barrier");
        let errors = errors_of(&gpu, neighbour, true);
        // Layers from 2024 on follow what kernels touch only when a setting asks for it.
        if errors.is_empty() && !is_required() {
            skipped("these validation layers do not follow what kernels touch");
            return;
        }
        let found = errors.iter().any(|e| e.to_lowercase().contains("hazard"));
        assert!(found, "{neighbour:?} without a barrier: {errors:?}");
    }
}

#[test]
fn sections_hold_no_sections_and_stay_with_their_device() {
    let (Some(gpu), Some(other)) = (device(), own_device()) else { return };
    let empty = |device: &Device| device.section(|_| Ok::<_, KernelError>(())).expect("records nothing");
    let section = empty(&gpu);
    let refused = |result: Result<(), KernelError>, what: &str| match result {
        Err(KernelError::Shape { kernel: "section", .. }) => {}
        other => panic!("{what}: {other:?}"),
    };
    refused(gpu.section(|rec| rec.replay(&section)).map(drop), "a section in a section");
    refused(gpu.recorder().and_then(|mut rec| rec.replay(&empty(&other))), "a section of another device");
    let swapped = gpu.section(|rec| {
        let theirs = std::mem::replace(rec, gpu.recorder()?);
        refused(theirs.submit().map(drop), "the recorder of a section");
        Ok::<_, KernelError>(())
    });
    refused(swapped.map(drop), "another recorder in its place");
    let mut rec = gpu.recorder().expect("recorder");
    rec.replay(&section).expect("replays nothing");
    assert_eq!(rec.submit().expect("runs").passes.len(), 0);
}

/// Names of the passes that were recorded, each with its part.
fn parts(rec: Recorder) -> Vec<(&'static str, Option<&'static str>)> {
    let timings = rec.submit().expect("runs");
    let all: Duration = [None, Some("inner"), Some("outer")].into_iter().map(|part| timings.of_part(part)).sum();
    assert_eq!(all, timings.total(), "each pass is in one part");
    timings.passes.iter().map(|p| (p.name, p.part)).collect()
}

#[test]
fn passes_name_the_part_that_they_were_recorded_in() {
    let Some(gpu) = device() else { return };
    let [mut first, mut second, _] = three(&gpu);
    let mut rec = gpu.recorder().expect("recorder");
    rec.fill(&mut first, 1.0);
    let refused = rec.part("outer", |rec| {
        mul_add::run(rec, CHAIN, &first, &mut second)?;
        rec.part("inner", |rec| rec.fill(&mut second, 2.0));
        rec.copy(&first, 0, &mut second, 0, LEN)?;
        rec.copy(&first, 1, &mut second, 0, LEN)
    });
    assert!(refused.is_err(), "a copy out of range");
    rec.fill(&mut second, 3.0);
    let want = [
        ("fill", None),
        ("probe/mul_add_run", Some("outer")),
        ("fill", Some("inner")),
        ("copy", Some("outer")),
        ("fill", None),
    ];
    assert_eq!(parts(rec), want, "the innermost counts, and an error ends a part as well");
}

#[test]
fn a_section_keeps_its_parts() {
    let Some(gpu) = device() else { return };
    let [mut first, mut second, _] = three(&gpu);
    let section = gpu
        .section(|rec| {
            rec.fill(&mut first, 1.0);
            rec.part("inner", |rec| mul_add::run(rec, CHAIN, &first, &mut second))
        })
        .expect("records");
    let mut rec = gpu.recorder().expect("recorder");
    rec.replay(&section).expect("replays");
    rec.part("outer", |rec| rec.replay(&section)).expect("replays");
    let want = [None, Some("outer")].map(|outer| [("fill", outer), ("probe/mul_add_run", Some("inner"))]);
    assert_eq!(parts(rec), want.concat(), "and passes without one take that of the replay");
}
