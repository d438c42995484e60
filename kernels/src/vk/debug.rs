//! Validation messages and object names.

use std::cell::RefCell;
use std::ffi::{CStr, c_void};

use ash::vk;

thread_local! {
    /// Messages arrive on the thread whose call caused them, so each thread (each test) sees its own.
    static ERRORS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// Error-level validation messages caused by this thread since the last call.
#[must_use]
pub fn take_validation_errors() -> Vec<String> {
    ERRORS.with(|errors| errors.borrow_mut().drain(..).collect())
}

/// Callback of the debug messenger: to tracing, and errors into this thread's list.
pub(super) unsafe extern "system" fn on_message(
    severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    _user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the loader passes a valid callback-data structure that lives for this call, and its
    // message is null or a NUL-terminated string.
    let text = unsafe {
        let message = (*data).p_message;
        if message.is_null() { String::new() } else { CStr::from_ptr(message).to_string_lossy().into_owned() }
    };
    if severity.contains(vk::DebugUtilsMessageSeverityFlagsEXT::ERROR) {
        tracing::error!(target: "vulkan", "{text}");
        ERRORS.with(|errors| errors.borrow_mut().push(text));
    } else {
        tracing::debug!(target: "vulkan", "{text}");
    }
    vk::FALSE
}
