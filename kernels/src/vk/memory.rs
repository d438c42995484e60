//! The allocator behind every buffer, with a running account of what is in use.

use ash::vk;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc};
use gpu_allocator::{AllocationSizes, AllocatorDebugSettings, MemoryLocation};

use super::device::MemoryUse;
use crate::error::KernelError;

pub(super) struct Memory {
    allocator: Allocator,
    used: MemoryUse,
}

impl Memory {
    pub(super) fn new(
        instance: &ash::Instance,
        device: &ash::Device,
        physical_device: vk::PhysicalDevice,
    ) -> Result<Self, KernelError> {
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.clone(),
            device: device.clone(),
            physical_device,
            debug_settings: AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: AllocationSizes::default(),
        })
        .map_err(|e| KernelError::Allocation { name: "allocator".into(), bytes: 0, reason: e.to_string() })?;
        Ok(Self { allocator, used: MemoryUse::default() })
    }

    pub(super) fn allocate(
        &mut self,
        name: &str,
        requirements: vk::MemoryRequirements,
        location: MemoryLocation,
    ) -> Result<Allocation, KernelError> {
        let allocation = self
            .allocator
            .allocate(&AllocationCreateDesc {
                name,
                requirements,
                location,
                linear: true,
                allocation_scheme: AllocationScheme::GpuAllocatorManaged,
            })
            .map_err(|e| KernelError::Allocation {
                name: name.to_owned(),
                bytes: requirements.size,
                reason: e.to_string(),
            })?;
        self.used.live_bytes += allocation.size();
        self.used.peak_bytes = self.used.peak_bytes.max(self.used.live_bytes);
        Ok(allocation)
    }

    pub(super) fn free(&mut self, allocation: Allocation) {
        self.used.live_bytes -= allocation.size();
        if let Err(e) = self.allocator.free(allocation) {
            tracing::error!("freeing device memory: {e}");
        }
    }

    pub(super) fn used(&self) -> MemoryUse {
        self.used
    }
}
