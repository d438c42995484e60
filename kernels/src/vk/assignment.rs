//! Which GPU a scheduler gave to this process.
//!
//! The variables that schedulers set hide devices from CUDA and ROCm, not from Vulkan: whoever ignores them takes the
//! machine's first GPU together with every other task.

use super::info::{DeviceInfo, DeviceKind};

/// PCI vendor numbers.
const NVIDIA: u32 = 0x10de;
const AMD: u32 = 0x1002;

/// Variables that name GPUs, in the order in which they are asked, and the maker whose GPUs they count. What numbers
/// the devices that a task can see comes before what numbers those of the whole machine.
const VARIABLES: [(&str, Option<u32>); 6] = [
    ("CUDA_VISIBLE_DEVICES", Some(NVIDIA)),
    ("ROCR_VISIBLE_DEVICES", Some(AMD)),
    ("HIP_VISIBLE_DEVICES", Some(AMD)),
    ("GPU_DEVICE_ORDINAL", None),
    ("SLURM_JOB_GPUS", None),
    ("CUE_GPU_CORES", None),
];
/// Number of the slot of a GNU parallel job, from 1. It says which GPU to take where there are several, no more.
const SLOT: &str = "PARALLEL_JOBSLOT";
/// Values that give no GPU.
const NONE: [&str; 5] = ["", "-1", "none", "void", "nodevfiles"];

/// What a scheduler's variable says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assignment {
    variable: &'static str,
    value: String,
    gpu: Gpu,
    vendor: Option<u32>,
}

/// The GPU that a value names; of several the first, since one is used.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Gpu {
    /// None may be used.
    Nothing,
    /// Position among the GPUs in the order of their PCI addresses.
    Index(usize),
    /// Position as before, if there are several; the only GPU where there is one.
    Slot(usize),
    /// Prefix of the device UUID, hex.
    Uuid(String),
    /// What no Vulkan device is called, such as a part of a GPU.
    Unknown,
}

impl Assignment {
    /// Names of the variables that [`Assignment::read`] asks for.
    pub fn variables() -> impl Iterator<Item = &'static str> {
        VARIABLES.iter().map(|(name, _)| *name).chain([SLOT])
    }

    /// What the environment, given by `variable`, assigns; `None` where no scheduler speaks.
    ///
    /// The first variable that names a GPU counts; if none does, the first that forbids all.
    pub fn read(variable: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let said = |(name, vendor): (&'static str, Option<u32>)| {
            let value = variable(name)?;
            let gpu = if name == SLOT { parse_slot(&value)? } else { parse(&value)? };
            Some(Self { variable: name, value, gpu, vendor })
        };
        let mut all: Vec<Self> = VARIABLES.into_iter().filter_map(said).collect();
        all.sort_by_key(|assignment| assignment.gpu == Gpu::Nothing);
        all.into_iter().next().or_else(|| said((SLOT, None)))
    }

    /// Index of the device that is meant; `None` if it is not here.
    #[must_use]
    pub fn choose(&self, devices: &[DeviceInfo]) -> Option<usize> {
        let gpus = self.gpus(devices);
        match &self.gpu {
            Gpu::Nothing => devices.iter().position(|d| d.kind == DeviceKind::Cpu),
            Gpu::Index(index) => gpus.get(*index).copied(),
            Gpu::Slot(index) => match gpus.len() {
                0 | 1 => gpus.first().copied().or((!devices.is_empty()).then_some(0)),
                _ => gpus.get(*index).copied(),
            },
            Gpu::Uuid(prefix) => {
                let mut same = gpus.into_iter().filter(|&i| devices[i].uuid.starts_with(prefix.as_str()));
                let first = same.next();
                // A prefix that fits several GPUs names none of them.
                if same.next().is_none() { first } else { None }
            }
            Gpu::Unknown => None,
        }
    }

    /// The GPUs that the variable counts, by PCI address; those without one keep the loader's order, behind the others.
    fn gpus(&self, devices: &[DeviceInfo]) -> Vec<usize> {
        let gpus = || (0..devices.len()).filter(|&i| devices[i].kind != DeviceKind::Cpu);
        let mut counted: Vec<usize> = gpus().filter(|&i| Some(devices[i].vendor) == self.vendor).collect();
        if counted.is_empty() {
            // Schedulers set one maker's variable on another's machine, too.
            counted = gpus().collect();
        }
        counted.sort_by_key(|&i| (devices[i].pci.is_none(), devices[i].pci.clone()));
        counted
    }
}

impl std::fmt::Display for Assignment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}={}", self.variable, self.value)
    }
}

/// `2`, `1,3`, `0-3`, `GPU-0a1b…` or nothing; `None` for `all`, which assigns nothing in particular.
fn parse(value: &str) -> Option<Gpu> {
    let first = value.split(',').next().unwrap_or_default().trim();
    let lower = first.to_lowercase();
    if lower == "all" {
        return None;
    }
    if NONE.contains(&lower.as_str()) {
        return Some(Gpu::Nothing);
    }
    if let Some(uuid) = lower.strip_prefix("gpu-") {
        let digits = uuid.replace('-', "");
        let is_hex = !digits.is_empty() && digits.chars().all(|c| c.is_ascii_hexdigit());
        return Some(if is_hex { Gpu::Uuid(digits) } else { Gpu::Unknown });
    }
    let start = lower.split('-').next().unwrap_or_default();
    Some(start.parse().map_or(Gpu::Unknown, Gpu::Index))
}

fn parse_slot(value: &str) -> Option<Gpu> {
    let slot: usize = value.trim().parse().ok()?;
    slot.checked_sub(1).map(Gpu::Slot)
}
