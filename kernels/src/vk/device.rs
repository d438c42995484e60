//! Opening a device, and what all its buffers and recorders share.

#[cfg(feature = "validation")]
use std::ffi::CStr;
use std::sync::{Arc, Mutex, MutexGuard};

use ash::vk;
use ash::vk::Handle;

use super::cooperation::Cooperation;
use super::family::{FamilySelect, KernelFamily};
use super::info::{DeviceInfo, HostAccess, MemoryUse};
use super::instance::{Instance, Uses};
use super::memory::Memory;
use super::pipeline::PipelineCache;
use super::result::check;
use super::select::DeviceSelect;
use super::slot::Slot;
use crate::error::KernelError;

/// How a device is opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceOptions {
    /// How the host reaches its memory.
    pub host_access: HostAccess,
    /// Which kernels it runs.
    pub kernels: FamilySelect,
    /// Largest storage binding to use in bytes, where that is less than the device's own limit: for finding out on any
    /// machine what a smaller device would do. Texel buffers, which lanes read large buffers through, keep theirs.
    pub max_storage_bytes: Option<u32>,
    /// Bytes that the machine is taken to have free for it, where that is not to be asked: for finding out what a
    /// smaller machine would do.
    pub free_memory: Option<u64>,
    /// Whether validation layers leave it alone, in builds that have them watch: they take nearly as long as small
    /// pictures do.
    pub unwatched: bool,
}

/// An open Vulkan device; cheap to clone.
#[derive(Clone)]
pub struct Device {
    inner: Arc<DeviceInner>,
}

impl std::fmt::Debug for Device {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Device({})", self.inner.info.name)
    }
}

pub(super) struct DeviceInner {
    pub(super) raw: ash::Device,
    pub(super) info: DeviceInfo,
    pub(super) host_access: HostAccess,
    pub(super) family: KernelFamily,
    pub(super) queue_family: u32,
    pub(super) pipelines: PipelineCache,
    pub(super) slots: Mutex<Vec<Slot>>,
    queue: Mutex<vk::Queue>,
    memory: Mutex<Option<Memory>>,
    names: Option<ash::ext::debug_utils::Device>,
    instance: Instance,
}

impl Device {
    /// What the loader finds on this machine, in its order.
    ///
    /// # Errors
    /// [`KernelError::NoDriver`] without a loader or driver.
    pub fn list() -> Result<Vec<DeviceInfo>, KernelError> {
        Ok(Instance::new(true)?.devices()?.into_iter().map(|(_, info)| info).collect())
    }

    /// Opens the device that `select` means, with the kernels that suit it.
    ///
    /// # Errors
    /// [`KernelError::NoDriver`], [`KernelError::NoDevice`], or [`KernelError::Unsuitable`] when the device has no
    /// compute queue with timestamps.
    pub fn open(select: &DeviceSelect) -> Result<Self, KernelError> {
        Self::open_with(select, DeviceOptions::default())
    }

    /// The same with a choice of how.
    ///
    /// # Errors
    /// As [`Device::open`], and [`KernelError::Unsuitable`] when it cannot run the kernels that are asked for.
    pub fn open_with(select: &DeviceSelect, options: DeviceOptions) -> Result<Self, KernelError> {
        let instance = Instance::new(!options.unwatched)?;
        let (physical, mut info) = instance.choose(select)?;
        if let Some(most) = options.max_storage_bytes {
            info.max_storage_bytes = info.max_storage_bytes.min(most);
        }
        let family = options.kernels.choose(&info)?;
        let queue_family = instance.compute_family(physical, &info)?;
        let raw = instance.create_device(physical, &info, queue_family, Uses::Work)?;
        // SAFETY: the family was requested with one queue.
        let queue = unsafe { raw.get_device_queue(queue_family, 0) };
        let memory = Memory::new(&instance.raw, &raw, instance.heaps(physical, &info, options.free_memory))?;
        let names = instance.messenger.is_some().then(|| ash::ext::debug_utils::Device::new(&instance.raw, &raw));
        tracing::debug!(device = info.name, driver = info.driver, %family, validated = names.is_some(), "opened");
        let inner = Arc::new(DeviceInner {
            raw,
            info,
            host_access: options.host_access,
            family,
            queue_family,
            pipelines: PipelineCache::new(family),
            slots: Mutex::default(),
            queue: Mutex::new(queue),
            memory: Mutex::new(Some(memory)),
            names,
            instance,
        });
        Ok(Self { inner })
    }

    /// Name, driver and limits.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.inner.info
    }

    /// Which kernels it runs; a wrapper that has a program for each asks this.
    #[must_use]
    pub fn family(&self) -> KernelFamily {
        self.inner.family
    }

    /// Device memory in buffers: now, at the peak, and how often some was taken.
    #[must_use]
    pub fn memory_use(&self) -> MemoryUse {
        self.inner.memory().used()
    }

    /// Takes at most `bytes` from the driver from now on; a buffer for which that is not enough is refused with
    /// [`KernelError::OverBudget`]. What is held already stays. Small buffers are refused only after the driver gave
    /// the block for them, so that for a moment one block more may be held.
    pub fn limit_memory(&self, bytes: u64) {
        self.inner.memory().limit(bytes);
    }

    /// Bytes that the driver would still give for buffers that kernels work in; `None` where it does not tell. On a
    /// processor that is what the machine has left.
    #[must_use]
    pub fn free_memory(&self) -> Option<u64> {
        self.inner.memory().free_bytes()
    }

    /// The limit that was set.
    #[must_use]
    pub fn memory_budget(&self) -> Option<u64> {
        self.inner.memory().budget()
    }

    /// Has the driver begin with what it remembers of kernels from before, and gives that to `keep` when the device
    /// goes. Data of another driver is for the driver to refuse, but nothing checks data that is damaged.
    ///
    /// # Errors
    /// When the driver fails.
    pub fn remember_pipelines(
        &self,
        known: &[u8],
        keep: impl FnOnce(&[u8]) + Send + 'static,
    ) -> Result<(), KernelError> {
        self.inner.pipelines.remember(&self.inner.raw, known, Box::new(keep))
    }

    /// Whether validation layers watch this device.
    #[must_use]
    pub fn is_validated(&self) -> bool {
        self.inner.instance.messenger.is_some()
    }

    /// How its subgroups multiply matrices of 16-bit floats.
    ///
    /// # Errors
    /// [`KernelError::Unsuitable`] when they do not.
    pub fn cooperation(&self) -> Result<Cooperation, KernelError> {
        self.inner.info.needed_cooperation()
    }

    pub(super) fn inner(&self) -> &Arc<DeviceInner> {
        &self.inner
    }

    /// Says `text` as an error, the way a validation layer does; for trying who listens. Nobody hears it where no layer
    /// watches.
    #[cfg(feature = "validation")]
    pub fn say_error(&self, text: &CStr) {
        let Some((loader, _)) = &self.inner.instance.messenger else { return };
        let data = vk::DebugUtilsMessengerCallbackDataEXT::default().message(text);
        let severity = vk::DebugUtilsMessageSeverityFlagsEXT::ERROR;
        // SAFETY: the extension is enabled and `text` outlives the call.
        unsafe {
            loader.submit_debug_utils_message(severity, vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION, &data);
        }
    }
}

/// Locked access to the allocator, which lives as long as the device.
pub(super) struct MemoryGuard<'a>(MutexGuard<'a, Option<Memory>>);

impl std::ops::Deref for MemoryGuard<'_> {
    type Target = Memory;
    fn deref(&self) -> &Memory {
        self.0.as_ref().expect("only dropping the device takes the allocator away")
    }
}

impl std::ops::DerefMut for MemoryGuard<'_> {
    fn deref_mut(&mut self) -> &mut Memory {
        self.0.as_mut().expect("only dropping the device takes the allocator away")
    }
}

impl DeviceInner {
    pub(super) fn memory(&self) -> MemoryGuard<'_> {
        MemoryGuard(self.memory.lock().expect("no panic happens while memory is locked"))
    }

    pub(super) fn name_object<H: Handle>(&self, handle: H, name: &str) {
        let (Some(names), Ok(name)) = (&self.names, std::ffi::CString::new(name)) else { return };
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(handle).object_name(&name);
        // SAFETY: the handle belongs to this device and the extension is enabled. A name that
        // cannot be set changes nothing but messages.
        let _ = unsafe { names.set_debug_utils_object_name(&info) };
    }

    /// Submits one recorded command buffer and waits for it.
    pub(super) fn submit_and_wait(&self, commands: vk::CommandBuffer, fence: vk::Fence) -> Result<(), KernelError> {
        let commands = [commands];
        let submits = [vk::SubmitInfo::default().command_buffers(&commands)];
        // SAFETY: the command buffer is recorded and its resources are held by the caller until
        // the fence, which this function waits for, has signalled.
        unsafe {
            {
                let queue = self.queue.lock().expect("no panic happens while the queue is locked");
                check("vkQueueSubmit", self.raw.queue_submit(*queue, &submits, fence))?;
            }
            check("vkWaitForFences", self.raw.wait_for_fences(&[fence], true, u64::MAX))?;
            check("vkResetFences", self.raw.reset_fences(&[fence]))
        }
    }
}

impl Drop for DeviceInner {
    fn drop(&mut self) {
        // SAFETY: buffers and recorders hold the device alive, so none exists any more; the
        // allocator must release its memory blocks before the device goes.
        unsafe {
            let slots = std::mem::take(&mut *self.slots.lock().expect("no panic happens while slots are locked"));
            for slot in slots {
                slot.destroy(&self.raw);
            }
            self.pipelines.destroy(&self.raw);
            drop(self.memory.lock().expect("no panic happens while memory is locked").take());
            self.raw.destroy_device(None);
        }
    }
}
