//! What is known of a device, and of the memory in use on it.

use ash::vk;

use super::cooperation::Cooperation;
use crate::error::KernelError;

/// What runs the kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceKind {
    /// A GPU on a card of its own.
    Discrete,
    /// A GPU beside the processor.
    Integrated,
    /// A GPU that a virtual machine shows.
    Virtual,
    /// The processor itself, by a software driver such as lavapipe.
    Cpu,
    /// Anything else.
    Other,
}

impl From<vk::PhysicalDeviceType> for DeviceKind {
    fn from(raw: vk::PhysicalDeviceType) -> Self {
        match raw {
            vk::PhysicalDeviceType::DISCRETE_GPU => Self::Discrete,
            vk::PhysicalDeviceType::INTEGRATED_GPU => Self::Integrated,
            vk::PhysicalDeviceType::VIRTUAL_GPU => Self::Virtual,
            vk::PhysicalDeviceType::CPU => Self::Cpu,
            _ => Self::Other,
        }
    }
}

/// What is known of a device before it is opened.
#[derive(Clone, Debug)]
pub struct DeviceInfo {
    /// Driver's device name.
    pub name: String,
    /// CPU, integrated, discrete, …
    pub kind: DeviceKind,
    /// PCI number of its maker.
    pub vendor: u32,
    /// Driver name and version in words.
    pub driver: String,
    /// Device UUID, 32 hex digits.
    pub uuid: String,
    /// PCI address where the driver tells it.
    pub pci: Option<String>,
    /// Largest storage-buffer binding in bytes.
    pub max_storage_bytes: u32,
    /// Largest texel buffer in texels.
    pub max_texel_elements: u32,
    /// Largest dispatch along x, in workgroups.
    pub max_groups_x: u32,
    /// Invocations per subgroup.
    pub subgroup_size: u32,
    /// Whether compute shaders may pass values between the lanes of a subgroup.
    pub has_shuffles: bool,
    /// Whether loads out of range give zeros.
    pub has_robust_loads: bool,
    /// The cooperative matrices that [`Half`](crate::nn::pack::Precision::Half) takes.
    pub cooperation: Option<Cooperation>,
    /// Nanoseconds per timestamp tick.
    pub timestamp_period_ns: f32,
}

impl DeviceInfo {
    /// How its subgroups multiply matrices of 16-bit floats.
    pub(super) fn needed_cooperation(&self) -> Result<Cooperation, KernelError> {
        self.cooperation.ok_or_else(|| KernelError::Unsuitable {
            device: self.name.clone(),
            what:
                "cooperative matrices of 16-bit floats with 32-bit sums (VK_KHR_cooperative_matrix), which precision \
                   f16 needs"
                    .to_owned(),
        })
    }
}

/// Device memory in buffers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MemoryUse {
    /// Bytes in use now.
    pub live_bytes: u64,
    /// Largest value of `live_bytes` so far.
    pub peak_bytes: u64,
    /// Bytes taken from the driver now: what is in use, and what lies idle in blocks.
    pub reserved_bytes: u64,
    /// Largest value of `reserved_bytes` so far.
    pub peak_reserved_bytes: u64,
    /// Allocations made so far, freed ones among them.
    pub allocations: u64,
}

/// How the host reaches the memory of buffers that kernels work in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HostAccess {
    /// Directly where the driver maps it, through staging memory elsewhere.
    #[default]
    Mapped,
    /// Through staging memory always, as on cards whose memory the host cannot see. Slower; for finding out on any
    /// machine what such a card would do.
    Staged,
}
