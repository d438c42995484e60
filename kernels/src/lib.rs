//! Vulkan compute kernels of guard4d: GLSL sources compiled at build time, typed host wrappers, CPU twins.

pub mod code;
pub mod error;
pub mod image;
pub mod loss;
pub mod nn;
pub mod optim;
pub mod probe;
#[cfg(feature = "reference")]
pub mod reference;
#[allow(clippy::unreadable_literal, missing_docs, reason = "generated code")]
pub mod registry;
pub mod scan;
pub mod shape;
pub mod splat;
pub mod vk;

pub use error::KernelError;
pub use vk::{
    Buffer, Device, DeviceOptions, DeviceSelect, FamilySelect, Grid, KernelFamily, Recorder, Section, Timings,
};
