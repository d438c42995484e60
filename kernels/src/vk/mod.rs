//! Everything that talks to Vulkan; the only place with `unsafe`.

mod assignment;
mod buffer;
mod cooperation;
mod debug;
mod device;
mod family;
mod memory;
mod pipeline;
mod recorder;
mod section;
mod select;

pub use assignment::Assignment;
pub use buffer::{Buffer, Element};
pub use cooperation::Cooperation;
pub(crate) use cooperation::TILE as COOP_TILE;
pub use debug::take_validation_errors;
pub use device::{Device, DeviceInfo, DeviceKind, DeviceOptions, HostAccess, MemoryUse};
pub use family::{FamilySelect, KernelFamily};
pub use memory::work_memory;
pub use pipeline::{BindingDef, BindingKind, KernelDef};
pub use recorder::{Bindings, Bound, Grid, PassTime, Recorder, Timings, last_finished};
pub use section::Section;
pub use select::DeviceSelect;

use ash::vk;
pub use ash::vk::{MemoryPropertyFlags, MemoryType};

use crate::error::KernelError;

/// Turns a Vulkan result into an error that names the call.
fn check<T>(call: &'static str, result: Result<T, vk::Result>) -> Result<T, KernelError> {
    result.map_err(|code| match code {
        vk::Result::ERROR_DEVICE_LOST => {
            KernelError::DeviceLost { last_pass: format!("unknown, `{call}` found it lost") }
        }
        other => KernelError::Vulkan { call, code: other.to_string() },
    })
}
