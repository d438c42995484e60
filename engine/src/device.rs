//! The Vulkan device that everything runs on: how one is chosen, opened and watched.

pub use guard4d_kernels::vk::{DeviceInfo, DeviceKind, MemoryUse};
pub use guard4d_kernels::{Device, DeviceOptions, DeviceSelect, FamilySelect, KernelFamily};
