//! Errors of the kernel layer.

use miette::Diagnostic;
use thiserror::Error;

/// Everything that can go wrong between a host wrapper and the device.
#[derive(Debug, Error, Diagnostic)]
pub enum KernelError {
    /// A buffer's length does not fit the shapes documented at the top of the shader.
    #[error("{kernel}: `{buffer}` is {got}, expected {expected}")]
    #[diagnostic(code(guard4d::kernels::shape), help("shapes are listed at the top of glsl/{kernel}*.comp"))]
    Shape {
        /// Registry stem, `family/op`.
        kernel: &'static str,
        /// Name of the offending buffer.
        buffer: &'static str,
        /// What was passed.
        got: String,
        /// What the kernel needs.
        expected: String,
    },
    /// No Vulkan loader or no driver on this machine.
    #[error("no Vulkan driver could be loaded: {reason}")]
    #[diagnostic(
        code(guard4d::kernels::no_driver),
        help("install a Vulkan driver; on Debian/Ubuntu: apt-get install libvulkan1 mesa-vulkan-drivers")
    )]
    NoDriver {
        /// The loader's own words.
        reason: String,
    },
    /// No device fits the selection.
    #[error("no Vulkan device fits `{wanted}`; present: {present}")]
    #[diagnostic(
        code(guard4d::kernels::no_device),
        help("`guard4d devices` lists what this machine has; --device takes one of them, `cpu` the processor")
    )]
    NoDevice {
        /// The selection, as the user wrote it.
        wanted: String,
        /// Names of the devices found.
        present: String,
    },
    /// The device lacks something that every kernel needs.
    #[error("device `{device}` lacks {what}")]
    #[diagnostic(code(guard4d::kernels::unsuitable))]
    Unsuitable {
        /// Device name.
        device: String,
        /// The missing feature or the limit that is too small.
        what: String,
    },
    /// A device allocation failed.
    #[error("cannot allocate {bytes} bytes for `{name}`: {reason}")]
    #[diagnostic(code(guard4d::kernels::allocation))]
    Allocation {
        /// Buffer name.
        name: String,
        /// Requested size.
        bytes: u64,
        /// The allocator's own words.
        reason: String,
    },
    /// A device allocation would break the budget.
    #[error(
        "`{name}` needs {bytes} bytes beyond the memory budget of {budget}: {live_bytes} are in use, {reserved_bytes} \
         taken from the driver"
    )]
    #[diagnostic(
        code(guard4d::kernels::over_budget),
        help("a larger --vram-budget, smaller pictures, or a smaller CLIP")
    )]
    OverBudget {
        /// Buffer name.
        name: String,
        /// Requested size.
        bytes: u64,
        /// Bytes that may be taken from the driver.
        budget: u64,
        /// Bytes in buffers.
        live_bytes: u64,
        /// Bytes taken from the driver.
        reserved_bytes: u64,
    },
    /// The device was lost while a submission ran.
    #[error("the device was lost; last pass known to have finished: {last_pass}")]
    #[diagnostic(code(guard4d::kernels::device_lost))]
    DeviceLost {
        /// Name and place of the last pass known to have finished, in words.
        last_pass: String,
    },
    /// Any other Vulkan call failed.
    #[error("{call} failed: {code}")]
    #[diagnostic(code(guard4d::kernels::vulkan))]
    Vulkan {
        /// Vulkan entry point.
        call: &'static str,
        /// Result code in words.
        code: String,
    },
}

impl KernelError {
    /// Whether something else has to give device memory back first, be it that a budget or the driver has no more.
    #[must_use]
    pub fn is_out_of_memory(&self) -> bool {
        matches!(self, Self::OverBudget { .. } | Self::Allocation { .. })
    }
}
