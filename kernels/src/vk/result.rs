//! Results of Vulkan calls.

use ash::vk;

use crate::error::KernelError;

/// Turns a Vulkan result into an error that names the call.
pub(super) fn check<T>(call: &'static str, result: Result<T, vk::Result>) -> Result<T, KernelError> {
    result.map_err(|code| match code {
        vk::Result::ERROR_DEVICE_LOST => {
            KernelError::DeviceLost { last_pass: format!("unknown, `{call}` found it lost") }
        }
        other => KernelError::Vulkan { call, code: other.to_string() },
    })
}
