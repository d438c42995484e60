//! The Vulkan instance: what devices there are, and the logical device of one of them.

use std::ffi::{CStr, c_char};

use ash::vk;

use super::cooperation::{self, Cooperation};
use super::debug;
use super::heaps::Heaps;
use super::info::DeviceInfo;
use super::result::check;
use super::select::DeviceSelect;
use crate::error::KernelError;

const VALIDATION_LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// What a device is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Uses {
    /// To run kernels.
    Work,
    /// To be asked what became of kernels.
    Statistics,
}

/// The Vulkan instance and its messenger.
pub(super) struct Instance {
    pub(super) raw: ash::Instance,
    pub(super) messenger: Option<(ash::ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    entry: ash::Entry,
}

impl Instance {
    /// In builds for it, and if `watched`, validation layers look on.
    pub(super) fn new(watched: bool) -> Result<Self, KernelError> {
        // SAFETY: loading the system's Vulkan loader has no precondition beyond its being one.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| KernelError::NoDriver { reason: e.to_string() })?;
        let validation = watched && cfg!(feature = "validation") && has_layer(&entry);
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

    pub(super) fn devices(&self) -> Result<Vec<(vk::PhysicalDevice, DeviceInfo)>, KernelError> {
        // SAFETY: the instance is alive.
        let all = check("vkEnumeratePhysicalDevices", unsafe { self.raw.enumerate_physical_devices() })?;
        Ok(all.into_iter().map(|d| (d, self.describe(d))).collect())
    }

    /// The device that is meant.
    pub(super) fn choose(&self, select: &DeviceSelect) -> Result<(vk::PhysicalDevice, DeviceInfo), KernelError> {
        let (handles, mut infos): (Vec<_>, Vec<_>) = self.devices()?.into_iter().unzip();
        if infos.is_empty() {
            return Err(KernelError::NoDriver { reason: "the loader finds no device".to_owned() });
        }
        let chosen = select.choose(&infos)?;
        Ok((handles[chosen], infos.swap_remove(chosen)))
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

    fn cooperation(&self, device: vk::PhysicalDevice, subgroup_size: u32) -> Option<Cooperation> {
        let has_it = self.has_extension(device, ash::khr::cooperative_matrix::NAME);
        has_it.then(|| cooperation::of_device(&self.entry, &self.raw, device, subgroup_size)).flatten()
    }

    fn has_extension(&self, device: vk::PhysicalDevice, name: &CStr) -> bool {
        // SAFETY: the physical device belongs to this instance.
        let list = unsafe { self.raw.enumerate_device_extension_properties(device) }.unwrap_or_default();
        list.iter().any(|e| e.extension_name_as_c_str() == Ok(name))
    }

    pub(super) fn heaps(&self, physical_device: vk::PhysicalDevice, info: &DeviceInfo, supposed: Option<u64>) -> Heaps {
        let has_budget = self.has_extension(physical_device, ash::ext::memory_budget::NAME);
        Heaps { instance: self.raw.clone(), physical_device, kind: info.kind, has_budget, supposed }
    }

    pub(super) fn compute_family(&self, physical: vk::PhysicalDevice, info: &DeviceInfo) -> Result<u32, KernelError> {
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

    pub(super) fn create_device(
        &self,
        physical: vk::PhysicalDevice,
        device: &DeviceInfo,
        family: u32,
        uses: Uses,
    ) -> Result<ash::Device, KernelError> {
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
        // Texel loads out of range must give zeros: the lane kernels pad with them. The tile kernels look at the range.
        let robust = device.has_robust_loads;
        let matrices = device.cooperation.is_some();
        let asks = uses == Uses::Statistics;
        if asks && !self.has_extension(physical, ash::khr::pipeline_executable_properties::NAME) {
            let what = "a driver that tells what it compiled (VK_KHR_pipeline_executable_properties)".to_owned();
            return Err(KernelError::Unsuitable { device: device.name.clone(), what });
        }
        let wanted = [
            (robust, ash::ext::robustness2::NAME),
            (matrices, ash::khr::cooperative_matrix::NAME),
            (asks, ash::khr::pipeline_executable_properties::NAME),
        ];
        let extensions: Vec<*const c_char> =
            wanted.iter().filter_map(|(want, name)| want.then_some(name.as_ptr())).collect();
        let mut robustness = vk::PhysicalDeviceRobustness2FeaturesEXT::default().robust_buffer_access2(true);
        let mut cooperation = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default().cooperative_matrix(true);
        let mut executables =
            vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
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
        if asks {
            info = info.push_next(&mut executables);
        }
        // SAFETY: every pointer in `info` outlives the call; the features were offered.
        check("vkCreateDevice", unsafe { self.raw.create_device(physical, &info, None) })
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
