//! Vulkan compute kernels of guard4d: GLSL sources compiled at build time, typed host wrappers, CPU twins.

pub mod error;

pub use error::KernelError;
