//! Which device a user or a scheduler means.

use std::collections::HashMap;

use guard4d_engine::error::EngineError;
use guard4d_kernels::vk::{Assignment, DeviceInfo, DeviceKind};
use guard4d_kernels::{DeviceSelect, FamilySelect, KernelFamily};

const NVIDIA: u32 = 0x10de;
const AMD: u32 = 0x1002;
const INTEL: u32 = 0x8086;

fn device(name: &str, kind: DeviceKind, vendor: u32, uuid: &str, pci: Option<&str>) -> DeviceInfo {
    DeviceInfo {
        name: name.to_owned(),
        kind,
        vendor,
        driver: "test".to_owned(),
        uuid: format!("{uuid:0<32}"),
        pci: pci.map(str::to_owned),
        max_storage_bytes: 1 << 27,
        max_texel_elements: 1 << 27,
        max_groups_x: 65_535,
        subgroup_size: 32,
        has_shuffles: true,
        has_robust_loads: true,
        cooperation: None,
        timestamp_period_ns: 1.0,
    }
}

/// A machine whose loader order is not the PCI order: an integrated GPU, lavapipe, and three cards.
fn mixed() -> Vec<DeviceInfo> {
    use DeviceKind::{Cpu, Discrete, Integrated};
    vec![
        device("integrated", Integrated, INTEL, "11", Some("0000:00:02.0")),
        device("llvmpipe", Cpu, 0x10005, "22", None),
        device("card at c1", Discrete, NVIDIA, "aaaa1", Some("0000:c1:00.0")),
        device("card at 41", Discrete, NVIDIA, "aaaa2", Some("0000:41:00.0")),
        device("radeon", Discrete, AMD, "bb", Some("0000:03:00.0")),
    ]
}

fn assignment(variables: &[(&str, &str)]) -> Option<Assignment> {
    let map: HashMap<_, _> = variables.iter().copied().collect();
    Assignment::read(|name| map.get(name).map(|value| (*value).to_owned()))
}

/// Name of the device that these variables assign.
#[track_caller]
fn chosen<'a>(devices: &'a [DeviceInfo], variables: &[(&str, &str)]) -> Option<&'a str> {
    let assignment = assignment(variables).expect("something is assigned");
    assignment.choose(devices).map(|index| devices[index].name.as_str())
}

#[test]
fn numbers_count_the_makers_gpus_in_pci_order() {
    let devices = mixed();
    for (variable, value, name) in [
        ("CUDA_VISIBLE_DEVICES", "0", Some("card at 41")),
        ("CUDA_VISIBLE_DEVICES", "1", Some("card at c1")),
        ("CUDA_VISIBLE_DEVICES", " 1,0", Some("card at c1")),
        ("CUDA_VISIBLE_DEVICES", "2", None),
        ("ROCR_VISIBLE_DEVICES", "0", Some("radeon")),
        ("HIP_VISIBLE_DEVICES", "1", None),
        ("GPU_DEVICE_ORDINAL", "0", Some("integrated")),
        ("SLURM_JOB_GPUS", "2-3", Some("card at 41")),
        ("CUE_GPU_CORES", "3", Some("card at c1")),
    ] {
        assert_eq!(chosen(&devices, &[(variable, value)]), name, "{variable}={value}");
    }
    let other = &devices[4..];
    assert_eq!(chosen(other, &[("CUDA_VISIBLE_DEVICES", "0")]), Some("radeon"), "where that maker's GPUs are missing");
    let no_pci: Vec<_> = mixed().into_iter().map(|d| DeviceInfo { pci: None, ..d }).collect();
    assert_eq!(chosen(&no_pci, &[("CUDA_VISIBLE_DEVICES", "0")]), Some("card at c1"), "the loader's order");
}

#[test]
fn uuids_are_found_by_a_prefix_of_one_gpu() {
    let devices = mixed();
    let cuda = |value| chosen(&devices, &[("CUDA_VISIBLE_DEVICES", value)]);
    assert_eq!(cuda("GPU-aaaa2"), Some("card at 41"), "a prefix, as HTCondor writes it");
    assert_eq!(cuda("GPU-AAAA1000-0000-0000-0000-000000000000"), Some("card at c1"), "whole, in any case");
    assert_eq!(cuda("GPU-aaaa"), None, "two GPUs");
    for value in ["GPU-cc", "GPU-", "GPU-xyz", "MIG-aaaa1", "MIG-GPU-aaaa1/0/0", "first"] {
        assert_eq!(cuda(value), None, "{value}");
    }
}

#[test]
fn no_gpu_is_the_processor_and_never_a_gpu() {
    let devices = mixed();
    for value in ["", "-1", "NoDevFiles", "none", " "] {
        assert_eq!(chosen(&devices, &[("CUDA_VISIBLE_DEVICES", value)]), Some("llvmpipe"), "`{value}`");
    }
    assert_eq!(chosen(&devices[2..], &[("CUDA_VISIBLE_DEVICES", "")]), None, "no software driver");
    let cpu = &devices[1..2];
    assert_eq!(chosen(cpu, &[("CUDA_VISIBLE_DEVICES", "0")]), None, "an assigned GPU is not replaced by the processor");
}

#[test]
fn the_first_variable_that_names_a_gpu_counts() {
    let devices = mixed();
    let both = [("SLURM_JOB_GPUS", "3"), ("CUDA_VISIBLE_DEVICES", "0"), ("PARALLEL_JOBSLOT", "1")];
    assert_eq!(chosen(&devices, &both), Some("card at 41"), "what the task can see, before the machine's numbers");
    let amd = [("CUDA_VISIBLE_DEVICES", ""), ("ROCR_VISIBLE_DEVICES", "0")];
    assert_eq!(chosen(&devices, &amd), Some("radeon"), "one that names none gives way");
    assert_eq!(assignment(&[]), None, "no scheduler");
    assert_eq!(assignment(&[("CUDA_VISIBLE_DEVICES", "all")]), None, "nothing in particular");
    let text = assignment(&both).map(|a| a.to_string());
    assert_eq!(text.as_deref(), Some("CUDA_VISIBLE_DEVICES=0"), "as messages name it");
}

#[test]
fn a_job_slot_chooses_among_several_gpus_only() {
    let devices = mixed();
    let slot = |devices, value| chosen(devices, &[("PARALLEL_JOBSLOT", value)]);
    assert_eq!(slot(&devices, "1"), Some("integrated"), "slots count from 1");
    assert_eq!(slot(&devices, "4"), Some("card at c1"), "the last");
    assert_eq!(slot(&devices, "5"), None, "more jobs than GPUs");
    assert_eq!(slot(&devices[1..3], "5"), Some("card at c1"), "the only GPU");
    assert_eq!(slot(&devices[1..2], "5"), Some("llvmpipe"), "no GPU");
    for value in ["0", "x", ""] {
        assert_eq!(assignment(&[("PARALLEL_JOBSLOT", value)]), None, "`{value}`");
    }
}

#[test]
fn what_the_user_says_comes_before_the_scheduler() {
    let devices = mixed();
    let cuda = |name: &str| (name == "CUDA_VISIBLE_DEVICES").then(|| "1".to_owned());
    let choose = |text: &str| text.parse::<DeviceSelect>().expect("a selection").or_assigned(cuda).choose(&devices);
    assert_eq!(choose("auto").ok(), Some(2), "the scheduler's");
    for (text, index) in [("cpu", 1), ("4", 4), ("name:RADEON", 4), ("uuid:GPU-aaaa2", 3), ("pci:0000:C1:00.0", 2)] {
        assert_eq!(choose(text).ok(), Some(index), "{text}");
    }
    let unassigned = DeviceSelect::Auto.or_assigned(|_| None);
    let refused = unassigned.choose(&devices).expect_err("several GPUs and nothing assigned").to_string();
    assert!(refused.contains("`auto`") && refused.contains("3: card at 41"), "{refused}");
    assert_eq!(unassigned.choose(&devices[..2]).ok(), Some(0), "the only GPU");
    assert_eq!(unassigned.choose(&devices[1..2]).ok(), Some(0), "no GPU");
    let far = DeviceSelect::Auto.or_assigned(|name| (name == "CUDA_VISIBLE_DEVICES").then(|| "7".to_owned()));
    let refused = far.choose(&devices).expect_err("not here").to_string();
    assert!(refused.contains("CUDA_VISIBLE_DEVICES=7") && refused.contains("integrated"), "{refused}");
}

#[test]
fn processors_take_lanes_and_everything_else_tiles() {
    for info in mixed() {
        let want = if info.kind == DeviceKind::Cpu { KernelFamily::Lanes } else { KernelFamily::Tiles };
        assert_eq!(FamilySelect::Auto.choose(&info).expect("any device runs something"), want, "{}", info.name);
    }
}

#[test]
fn what_lanes_need_is_looked_for_and_named() {
    let able = device("llvmpipe", DeviceKind::Cpu, 0x10005, "22", None);
    for (unable, what) in [
        (DeviceInfo { subgroup_size: 4, ..able.clone() }, "subgroups of 8 or more lanes"),
        (DeviceInfo { has_shuffles: false, ..able.clone() }, "with shuffles"),
        (DeviceInfo { max_texel_elements: 65_536, ..able.clone() }, "(it has 65536)"),
        (DeviceInfo { has_robust_loads: false, ..able.clone() }, "robustBufferAccess2"),
    ] {
        assert_eq!(FamilySelect::Auto.choose(&unable).expect("tiles run everywhere"), KernelFamily::Tiles, "{what}");
        let refused = FamilySelect::Only(KernelFamily::Lanes).choose(&unable).expect_err("lanes do not");
        let refused = EngineError::from(refused);
        // docs/reference/exit-codes.md
        assert_eq!(refused.exit_code(), 69);
        assert!(refused.to_string().contains(what), "{refused}");
        assert!(refused.to_string().contains("--kernels tiles"), "says what to do: {refused}");
    }
}

#[test]
fn kernels_are_what_is_asked_for() {
    for info in mixed() {
        for family in [KernelFamily::Lanes, KernelFamily::Tiles] {
            let asked: FamilySelect = family.to_string().parse().expect("names are read back");
            assert_eq!(asked.choose(&info).expect("all of them can"), family, "{}", info.name);
        }
    }
    assert!("warps".parse::<FamilySelect>().is_err(), "nothing else is a name");
}
