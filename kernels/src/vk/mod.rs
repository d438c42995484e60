//! Everything that talks to Vulkan; the only place with `unsafe`.

mod assignment;
mod buffer;
mod cooperation;
mod debug;
mod device;
mod family;
mod heaps;
mod info;
mod instance;
mod memory;
mod pipeline;
mod recorder;
mod result;
mod select;
mod slot;
mod statistics;
mod transfer;

pub use ash::vk::{MemoryPropertyFlags, MemoryType};
pub use assignment::Assignment;
pub use buffer::{Buffer, Element};
pub use cooperation::Cooperation;
pub(crate) use cooperation::TILE as COOP_TILE;
pub use debug::take_validation_errors;
pub use device::{Device, DeviceOptions};
pub use family::{FamilySelect, KernelFamily};
pub use info::{DeviceInfo, DeviceKind, HostAccess, MemoryUse};
pub use memory::work_memory;
pub use pipeline::{BindingDef, BindingKind, KernelDef};
pub use recorder::{Bindings, Bound, Grid, PassTime, Recorder, Section, Timings, last_finished};
pub use select::DeviceSelect;
pub use statistics::{DriverStatistics, ProgramStatistics, statistics};
