//! Opening a device, and what all its buffers and recorders share.

use std::ffi::{CStr, c_char};
use std::sync::{Arc, Mutex, MutexGuard};

use ash::vk;
use ash::vk::Handle;

use super::buffer::BufferInner;
use super::cooperation::Cooperation;
use super::family::{FamilySelect, KernelFamily};
use super::memory::Memory;
use super::pipeline::PipelineCache;
use super::recorder::Slot;
use super::select::DeviceSelect;
use super::{check, debug};
use crate::error::KernelError;

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

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

/// The Vulkan instance and its messenger.
pub(super) struct Instance {
    pub(super) raw: ash::Instance,
    messenger: Option<(ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    pub(super) entry: ash::Entry,
}

impl Instance {
    fn new() -> Result<Self, KernelError> {
        // SAFETY: loading the system's Vulkan loader has no precondition beyond its being one.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| KernelError::NoDriver { reason: e.to_string() })?;
        let validation = cfg!(feature = "validation") && has_layer(&entry);
        let layers: Vec<*const c_char> = if validation { vec![VALIDATION_LAYER.as_ptr()] } else { Vec::new() };
        let extensions: Vec<*const c_char> =
            if validation { vec![ash::ext::debug_utils::NAME.as_ptr()] } else { Vec::new() };
        let application = vk::ApplicationInfo::default().application_name(c"guard4d").api_version(vk::API_VERSION_1_2);
        let enables = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enables);
        // Hears what is said while the instance is made and destroyed, when no messenger exists.
        let mut early = messenger_info();
        let mut info = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_layer_names(&layers)
            .enabled_extension_names(&extensions);
        if validation {
            info = info.push_next(&mut features).push_next(&mut early);
        }
        // SAFETY: every pointer in `info` outlives the call.
        let raw = unsafe { entry.create_instance(&info, None) }
            .map_err(|e| KernelError::NoDriver { reason: format!("vkCreateInstance: {e}") })?;
        let messenger = if validation { Some(messenger(&entry, &raw)?) } else { None };
        Ok(Self { raw, messenger, entry })
    }

    fn devices(&self) -> Result<Vec<(vk::PhysicalDevice, DeviceInfo)>, KernelError> {
        // SAFETY: the instance is alive.
        let all = check("vkEnumeratePhysicalDevices", unsafe { self.raw.enumerate_physical_devices() })?;
        Ok(all.into_iter().map(|d| (d, self.describe(d))).collect())
    }

    fn describe(&self, device: vk::PhysicalDevice) -> DeviceInfo {
        let has_pci = self.has_extension(device, ash::ext::pci_bus_info::NAME);
        let mut pci = vk::PhysicalDevicePCIBusInfoPropertiesEXT::default();
        let mut id = vk::PhysicalDeviceIDProperties::default();
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
        let mut properties =
            vk::PhysicalDeviceProperties2::default().push_next(&mut id).push_next(&mut driver).push_next(&mut subgroup);
        if has_pci {
            properties = properties.push_next(&mut pci);
        }
        // SAFETY: the chain holds only structures that the device's version and extensions define.
        unsafe { self.raw.get_physical_device_properties2(device, &mut properties) };
        let base = properties.properties;
        let text = |t: Result<&CStr, _>| t.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        DeviceInfo {
            name: text(base.device_name_as_c_str()),
            kind: base.device_type.into(),
            vendor: base.vendor_id,
            driver: format!("{} {}", text(driver.driver_name_as_c_str()), text(driver.driver_info_as_c_str())),
            uuid: id.device_uuid.iter().map(|b| format!("{b:02x}")).collect(),
            pci: has_pci.then(|| {
                format!("{:04x}:{:02x}:{:02x}.{:x}", pci.pci_domain, pci.pci_bus, pci.pci_device, pci.pci_function)
            }),
            max_storage_bytes: base.limits.max_storage_buffer_range,
            max_texel_elements: base.limits.max_texel_buffer_elements,
            max_groups_x: base.limits.max_compute_work_group_count[0],
            subgroup_size: subgroup.subgroup_size,
            has_shuffles: subgroup.supported_operations.contains(vk::SubgroupFeatureFlags::SHUFFLE)
                && subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE),
            has_robust_loads: self.has_robust_loads(device),
            cooperation: self.cooperation(device, subgroup.subgroup_size),
            timestamp_period_ns: base.limits.timestamp_period,
        }
    }

    fn has_robust_loads(&self, device: vk::PhysicalDevice) -> bool {
        if !self.has_extension(device, ash::ext::robustness2::NAME) {
            return false;
        }
        let mut robustness = vk::PhysicalDeviceRobustness2FeaturesEXT::default();
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut robustness);
        // SAFETY: the chain holds only a structure that an extension of the device defines.
        unsafe { self.raw.get_physical_device_features2(device, &mut features) };
        robustness.robust_buffer_access2 == vk::TRUE
    }

    pub(super) fn has_extension(&self, device: vk::PhysicalDevice, name: &CStr) -> bool {
        // SAFETY: the physical device belongs to this instance.
        let list = unsafe { self.raw.enumerate_device_extension_properties(device) }.unwrap_or_default();
        list.iter().any(|e| e.extension_name_as_c_str() == Ok(name))
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // SAFETY: the device made from this instance is destroyed before it (field order and
        // `DeviceInner::drop`), and nothing else was made from it.
        unsafe {
            if let Some((loader, messenger)) = &self.messenger {
                loader.destroy_debug_utils_messenger(*messenger, None);
            }
            self.raw.destroy_instance(None);
        }
    }
}

fn has_layer(entry: &ash::Entry) -> bool {
    // SAFETY: the entry is a loaded Vulkan loader.
    let layers = unsafe { entry.enumerate_instance_layer_properties() }.unwrap_or_default();
    layers.iter().any(|l| l.layer_name_as_c_str() == Ok(VALIDATION_LAYER))
}

fn messenger_info() -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    use vk::{DebugUtilsMessageSeverityFlagsEXT as Severity, DebugUtilsMessageTypeFlagsEXT as Kind};
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(Severity::ERROR | Severity::WARNING)
        .message_type(Kind::VALIDATION | Kind::PERFORMANCE | Kind::GENERAL)
        .pfn_user_callback(Some(debug::on_message))
}

fn messenger(
    entry: &ash::Entry,
    instance: &ash::Instance,
) -> Result<(ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT), KernelError> {
    let loader = ash::ext::debug_utils::Instance::new(entry, instance);
    let info = messenger_info();
    // SAFETY: the extension is enabled and the callback matches the required signature.
    let messenger =
        check("vkCreateDebugUtilsMessengerEXT", unsafe { loader.create_debug_utils_messenger(&info, None) })?;
    Ok((loader, messenger))
}

impl Device {
    /// What the loader finds on this machine, in its order.
    ///
    /// # Errors
    /// [`KernelError::NoDriver`] without a loader or driver.
    pub fn list() -> Result<Vec<DeviceInfo>, KernelError> {
        Ok(Instance::new()?.devices()?.into_iter().map(|(_, info)| info).collect())
    }

    /// Opens the device that `select` means, with the kernels that suit it.
    ///
    /// # Errors
    /// [`KernelError::NoDriver`], [`KernelError::NoDevice`], or [`KernelError::Unsuitable`] when the device has no compute
    /// queue with timestamps.
    pub fn open(select: &DeviceSelect) -> Result<Self, KernelError> {
        Self::open_with(select, DeviceOptions::default())
    }

    /// The same with a choice of how.
    ///
    /// # Errors
    /// As [`Device::open`], and [`KernelError::Unsuitable`] when it cannot run the kernels that are asked for.
    pub fn open_with(select: &DeviceSelect, options: DeviceOptions) -> Result<Self, KernelError> {
        let instance = Instance::new()?;
        let (handles, infos): (Vec<_>, Vec<_>) = instance.devices()?.into_iter().unzip();
        if infos.is_empty() {
            return Err(KernelError::NoDriver { reason: "the loader finds no device".to_owned() });
        }
        let chosen = select.choose(&infos)?;
        let (physical, mut info) = (handles[chosen], infos[chosen].clone());
        if let Some(most) = options.max_storage_bytes {
            info.max_storage_bytes = info.max_storage_bytes.min(most);
        }
        let family = options.kernels.choose(&info)?;
        let queue_family = instance.compute_family(physical, &info)?;
        let raw = instance.create_device(physical, &info, queue_family)?;
        // SAFETY: the family was requested with one queue.
        let queue = unsafe { raw.get_device_queue(queue_family, 0) };
        let memory = Memory::new(&instance.raw, &raw, physical, info.kind)?;
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

    /// The limit that was set.
    #[must_use]
    pub fn memory_budget(&self) -> Option<u64> {
        self.inner.memory().budget()
    }

    /// Whether validation layers watch this device.
    #[must_use]
    pub fn is_validated(&self) -> bool {
        self.inner.instance.messenger.is_some()
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

impl Instance {
    fn compute_family(&self, physical: vk::PhysicalDevice, info: &DeviceInfo) -> Result<u32, KernelError> {
        // SAFETY: the physical device belongs to this instance.
        let families = unsafe { self.raw.get_physical_device_queue_family_properties(physical) };
        let usable = |f: &vk::QueueFamilyProperties| {
            f.queue_flags.contains(vk::QueueFlags::COMPUTE) && f.timestamp_valid_bits > 0
        };
        (0u32..).zip(&families).find(|(_, f)| usable(f)).map(|(i, _)| i).ok_or_else(|| KernelError::Unsuitable {
            device: info.name.clone(),
            what: "a compute queue with timestamps".to_owned(),
        })
    }

    fn create_device(
        &self,
        physical: vk::PhysicalDevice,
        device: &DeviceInfo,
        family: u32,
    ) -> Result<ash::Device, KernelError> {
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
        // Texel loads out of range must give zeros: the lane kernels pad with them. The tile kernels look at the range.
        let robust = device.has_robust_loads;
        let matrices = device.cooperation.is_some();
        let wanted = [(robust, ash::ext::robustness2::NAME), (matrices, ash::khr::cooperative_matrix::NAME)];
        let extensions: Vec<*const c_char> =
            wanted.iter().filter_map(|(want, name)| want.then_some(name.as_ptr())).collect();
        let mut robustness = vk::PhysicalDeviceRobustness2FeaturesEXT::default().robust_buffer_access2(true);
        let mut cooperation = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default().cooperative_matrix(true);
        let mut core = vk::PhysicalDeviceVulkan12Features::default()
            .shader_float16(true)
            .vulkan_memory_model(true)
            .vulkan_memory_model_device_scope(true);
        let features = vk::PhysicalDeviceFeatures::default().robust_buffer_access(true);
        let mut info = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_extension_names(&extensions)
            .enabled_features(&features);
        if robust {
            info = info.push_next(&mut robustness);
        }
        if matrices {
            info = info.push_next(&mut cooperation).push_next(&mut core);
        }
        // SAFETY: every pointer in `info` outlives the call; the features were offered.
        check("vkCreateDevice", unsafe { self.raw.create_device(physical, &info, None) })
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

    /// Copies bytes between buffers in a submission of its own.
    pub(super) fn copy_now(
        self: &Arc<Self>,
        from: &Arc<BufferInner>,
        from_offset: u64,
        to: &Arc<BufferInner>,
        to_offset: u64,
        bytes: u64,
    ) -> Result<(), KernelError> {
        let mut recorder = super::Recorder::new(self)?;
        let region = vk::BufferCopy { src_offset: from_offset, dst_offset: to_offset, size: bytes };
        recorder.copy_region(from, to, region);
        recorder.submit().map(drop)
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
