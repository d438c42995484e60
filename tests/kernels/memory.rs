//! Where buffers live, what is counted of them, and what is said when there is no room.

use guard4d_engine::error::EngineError;
use guard4d_kernels::KernelError;
use guard4d_kernels::vk::{DeviceKind, MemoryPropertyFlags as Property, MemoryType, MemoryUse, work_memory};

use crate::support::gpu::{device_with_free, own_device, staged_device};

const LOCAL: Property = Property::DEVICE_LOCAL;
const HOST: Property = Property::from_raw(Property::HOST_VISIBLE.as_raw() | Property::HOST_COHERENT.as_raw());
const CACHED: Property = Property::HOST_CACHED;

/// A memory table: properties and heap of each type.
fn table(types: &[(Property, u32)]) -> Vec<MemoryType> {
    types.iter().map(|&(property_flags, heap_index)| MemoryType { property_flags, heap_index }).collect()
}

/// Types in the order in which they are tried, one list for each mask.
fn order(types: &[(Property, u32)], kind: DeviceKind) -> Vec<Vec<usize>> {
    let masks = work_memory(&table(types), kind);
    masks.iter().map(|mask| (0..types.len()).filter(|i| mask >> i & 1 == 1).collect()).collect()
}

#[test]
fn a_software_driver_has_one_type_and_it_is_mapped() {
    let llvmpipe = [(LOCAL | HOST | CACHED, 0)];
    assert_eq!(order(&llvmpipe, DeviceKind::Cpu), [[0]]);
}

#[test]
fn shared_memory_is_mapped_and_cached_where_that_exists() {
    // An integrated GPU whose first type is not mapped, and whose first mapped type is not cached.
    let integrated = [(LOCAL, 0), (LOCAL | HOST, 0), (LOCAL | HOST | CACHED, 0), (LOCAL | Property::PROTECTED, 0)];
    assert_eq!(order(&integrated, DeviceKind::Integrated), [[2], [1], [0], [3]], "protected memory comes last");
    let uncached = [(LOCAL, 0), (LOCAL | HOST, 0)];
    assert_eq!(order(&uncached, DeviceKind::Integrated), [[1], [0]]);
    // Part of the main memory set aside for the GPU; what is outside it is not its own.
    let carved = [(LOCAL, 0), (HOST, 1), (LOCAL | HOST, 2), (HOST | CACHED, 1)];
    assert_eq!(order(&carved, DeviceKind::Integrated), [[2], [0]], "the larger heap when the mapped one is full");
}

#[test]
fn a_card_keeps_its_own_memory_whatever_it_lets_the_host_see() {
    let small_window = [(LOCAL, 0), (HOST, 1), (HOST | CACHED, 1), (LOCAL | HOST, 2)];
    assert_eq!(order(&small_window, DeviceKind::Discrete), [[0], [3]]);
    let no_window = &small_window[..3];
    assert_eq!(order(no_window, DeviceKind::Discrete), [[0]]);
    // All of the card's memory is in the window, and a driver lists the mapped type first.
    let resizable = [(LOCAL | HOST, 0), (HOST | CACHED, 1), (LOCAL, 0)];
    assert_eq!(order(&resizable, DeviceKind::Discrete), [[2], [0]]);
    let mapped_only = [(HOST, 1), (LOCAL | HOST, 0)];
    assert_eq!(order(&mapped_only, DeviceKind::Discrete), [[1]], "better than nothing");
}

#[test]
fn of_other_devices_the_heaps_decide() {
    let visible = [(LOCAL, 0), (LOCAL | HOST, 0), (HOST, 1)];
    let hidden = [(LOCAL, 0), (LOCAL | HOST, 1), (HOST, 2)];
    for kind in [DeviceKind::Virtual, DeviceKind::Other] {
        assert_eq!(order(&visible, kind), [[1], [0]], "{kind:?}: all of its memory can be mapped");
        assert_eq!(order(&hidden, kind), [[0], [1]], "{kind:?}: part of it cannot");
    }
    assert!(order(&[(HOST, 0)], DeviceKind::Other).is_empty(), "nothing is local");
}

#[test]
fn memory_in_use_and_its_peak_are_counted() {
    let Some(gpu) = own_device() else { return };
    assert_eq!(gpu.memory_use(), MemoryUse::default(), "nothing yet");
    let len = 1000;
    let bytes = (len * size_of::<f32>()) as u64;
    let first = gpu.buffer::<f32>("first", len).expect("buffer");
    let second = gpu.buffer::<f32>("second", len).expect("buffer");
    let both = gpu.memory_use();
    assert!(both.live_bytes >= 2 * bytes && both.peak_bytes >= both.live_bytes, "{both:?}");
    drop(first);
    let one = gpu.memory_use();
    assert!(one.live_bytes >= bytes && one.live_bytes < both.live_bytes, "{one:?}");
    assert_eq!(one.peak_bytes, both.peak_bytes, "the peak stays");
    assert_eq!(second.read().expect("read"), vec![0.0; len]);
    drop(second);
    assert_eq!(gpu.memory_use().live_bytes, 0);
    if matches!(gpu.info().kind, DeviceKind::Cpu | DeviceKind::Integrated) {
        // A staging buffer for the zeros or for the reading would have added to it.
        assert_eq!(gpu.memory_use().peak_bytes, both.live_bytes, "no copy through another buffer");
    }
}

#[test]
fn no_room_is_an_error_that_names_who_holds_the_memory() {
    let Some(gpu) = own_device() else { return };
    let held: Vec<_> = [("small", 100), ("large", 5000), ("middle", 1000), ("tiny", 10)]
        .iter()
        .map(|&(name, len)| gpu.buffer::<f32>(name, len).expect("buffer"))
        .collect();
    // A terabyte; no device has one.
    let error = gpu.buffer::<f32>("scene of a lifetime", 1 << 38).expect_err("no room");
    let KernelError::Allocation { name, bytes, reason } = &error else { panic!("{error:?}") };
    assert_eq!((name.as_str(), *bytes), ("scene of a lifetime", 1 << 40));
    let places = ["`large` ", "`middle` ", "`small` "].map(|name| reason.find(name).expect("it is named"));
    assert!(places.is_sorted(), "the largest first: {reason}");
    assert!(!reason.contains("tiny") && reason.contains("4 buffers hold"), "{reason}");
    let message = error.to_string();
    assert!(message.contains("1099511627776 bytes for `scene of a lifetime`"), "{message}");
    assert_eq!(EngineError::from(error).exit_code(), 69);
    assert_eq!(held[1].read().expect("read"), vec![0.0; 5000], "what was there is as it was");
}

#[test]
fn a_budget_refuses_what_would_break_it_and_nothing_else() {
    let Some(gpu) = own_device() else { return };
    assert_eq!(gpu.memory_budget(), None);
    // Small buffers share a block, a large one takes memory for itself: what is as large as a block always does.
    let part = |share: usize, block: u64| share * block as usize / 2048 / size_of::<f32>();
    let first = gpu.buffer::<f32>("first", 4).expect("buffer");
    let block = gpu.memory_use().reserved_bytes;
    let small: Vec<_> = (0..2046).map(|_| gpu.buffer::<f32>("small", part(1, block)).expect("buffer")).collect();
    let large = gpu.buffer::<f32>("large", part(2560, block)).expect("buffer");
    let used = gpu.memory_use();
    assert_eq!(used.reserved_bytes, block + 2560 * block / 2048, "{used:?}");
    let budget = used.reserved_bytes + block / 2;
    gpu.limit_memory(budget);
    assert_eq!(gpu.memory_budget(), Some(budget));
    let last = gpu.buffer::<f32>("fits in the first block", part(1, block)).expect("no new block");
    assert_eq!(gpu.memory_use().reserved_bytes, used.reserved_bytes, "as it was");
    for (name, share) in [("needs a second block", 1), ("needs memory of its own", 2048)] {
        let used = gpu.memory_use();
        let len = part(share, block);
        let error = gpu.buffer::<f32>(name, len).expect_err("beyond the budget");
        let KernelError::OverBudget { name: told, bytes, budget: limit, live_bytes, reserved_bytes } = &error else {
            panic!("{error:?}");
        };
        assert_eq!((told.as_str(), *bytes, *limit), (name, 4 * len as u64, budget));
        assert_eq!((*live_bytes, *reserved_bytes), (used.live_bytes, used.reserved_bytes));
        assert!(error.to_string().contains(&format!("memory budget of {budget}")), "{error}");
        assert_eq!(EngineError::from(error).exit_code(), 69);
        assert_eq!(gpu.memory_use(), used, "a refusal leaves nothing behind");
    }
    drop(large);
    gpu.buffer::<f32>("fits now", part(3584, block)).expect("the large one is gone");
    assert!(gpu.memory_use().peak_reserved_bytes <= budget, "{:?}", gpu.memory_use());
    assert_eq!(small[0].read_range(0..1).expect("reads"), [0.0], "what was there is as it was");
    drop((first, last));
}

#[test]
fn a_processor_does_not_take_all_that_the_machine_has_free() {
    let free = 64 << 20;
    let Some(gpu) = device_with_free(free) else { return };
    assert_eq!(gpu.free_memory(), Some(free), "as it was told");
    let len = |bytes: u64| bytes as usize / size_of::<f32>();
    let half = gpu.buffer::<f32>("half", len(free / 2)).expect("there is room");
    let used = gpu.memory_use();
    let error = gpu.buffer::<f32>("the other half", len(free / 2)).expect_err("more than three quarters");
    let KernelError::Allocation { name, reason, .. } = &error else { panic!("{error:?}") };
    assert_eq!(name, "the other half");
    let why = format!("beyond {} bytes, three quarters of what the machine had free", free / 4 * 3);
    assert!(reason.contains(&why) && reason.contains("`half`"), "{reason}");
    assert!(error.is_out_of_memory());
    assert_eq!(gpu.memory_use(), used, "a refusal leaves nothing behind");
    // Whoever sets a budget knows better.
    gpu.limit_memory(2 * free);
    assert!(gpu.buffer::<f32>("the other half", len(free / 2)).is_ok());
    drop(half);

    let Some(gpu) = own_device() else { return };
    let first = gpu.free_memory();
    if gpu.info().kind == DeviceKind::Cpu {
        assert!(first.is_some_and(|bytes| bytes > 64 << 20), "a machine that runs these tests has some: {first:?}");
    }
}

#[test]
fn new_buffers_are_zero_whatever_lay_there() {
    for gpu in [own_device(), staged_device()] {
        let Some(gpu) = gpu else { return };
        // In a block, in memory of its own, and with padding to a whole texel.
        for len in [3, 64, 1 << 19] {
            drop(gpu.buffer_from("before", &vec![7.0f32; len]).expect("buffer"));
            let after = gpu.buffer::<f32>("after", len).expect("buffer");
            assert_eq!(after.read().expect("read"), vec![0.0; len]);
            let data: Vec<f32> = (0..len).map(|i| i as f32 + 0.5).collect();
            drop(gpu.buffer_from("before", &vec![7.0f32; len]).expect("buffer"));
            assert_eq!(gpu.buffer_from("data", &data).expect("buffer").read().expect("read"), data);
        }
    }
}

#[test]
fn large_buffers_leave_no_gaps() {
    let Some(gpu) = own_device() else { return };
    let first = gpu.buffer::<f32>("first", 4).expect("buffer");
    let block = gpu.memory_use().reserved_bytes;
    // Larger than half a block: side by side in blocks, each would leave the rest of its block idle.
    let len = 5 * block as usize / 8 / size_of::<f32>();
    let held: Vec<_> = (0..40).map(|_| gpu.buffer::<f32>("large", len).expect("buffer")).collect();
    let MemoryUse { live_bytes, reserved_bytes, .. } = gpu.memory_use();
    assert_eq!(reserved_bytes, block + 4 * (held.len() * len) as u64, "{live_bytes} bytes are in use");
    drop(first);
}
