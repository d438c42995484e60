//! How much memory of a device is free.

use ash::vk;
use sysinfo::{MemoryRefreshKind, RefreshKind, System};

use super::info::DeviceKind;

/// Where a device has its memory.
pub(super) struct Heaps {
    /// Lives as long as the device.
    pub(super) instance: ash::Instance,
    pub(super) physical_device: vk::PhysicalDevice,
    pub(super) kind: DeviceKind,
    /// Whether the driver tells what it would give (VK_EXT_memory_budget).
    pub(super) has_budget: bool,
    /// Bytes that are taken to be free, whatever anybody tells.
    pub(super) supposed: Option<u64>,
}

impl Heaps {
    /// Bytes that the driver would still give for memory types of any of these masks; `None` where it does not tell.
    ///
    /// Drivers that run on the processor take what the machine, or the control group of this process, has left,
    /// whatever they say of their heap: lavapipe 22.3 calls it 2 GiB everywhere.
    pub(super) fn free_bytes(&self, masks: &[u32]) -> Option<u64> {
        if self.supposed.is_some() {
            return self.supposed;
        }
        if self.kind == DeviceKind::Cpu {
            let memory = RefreshKind::nothing().with_memory(MemoryRefreshKind::nothing().with_ram());
            let system = System::new_with_specifics(memory).ok()?;
            let free = system.available_memory();
            // Of a control group only what cannot be dropped counts as taken: its files in memory can.
            let group = system.cgroup_limits().map(|group| group.total_memory.saturating_sub(group.rss));
            return Some(group.map_or(free, |left| left.min(free)));
        }
        if !self.has_budget {
            return None;
        }
        let mut budget = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
        let mut properties = vk::PhysicalDeviceMemoryProperties2::default().push_next(&mut budget);
        // SAFETY: the physical device belongs to the instance, and offers the extension that defines the structure.
        unsafe { self.instance.get_physical_device_memory_properties2(self.physical_device, &mut properties) };
        let types = properties.memory_properties;
        let all = masks.iter().fold(0, |all, mask| all | mask);
        let is_used = |heap: usize| {
            let of_heap = |(i, t): (usize, &vk::MemoryType)| all >> i & 1 == 1 && t.heap_index as usize == heap;
            types.memory_types_as_slice().iter().enumerate().any(of_heap)
        };
        let free = |heap: usize| budget.heap_budget[heap].saturating_sub(budget.heap_usage[heap]);
        Some((0..types.memory_heap_count as usize).filter(|heap| is_used(*heap)).map(free).sum())
    }
}
