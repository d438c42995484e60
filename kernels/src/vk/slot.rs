//! The handles that recording takes, kept from one recorder to the next.

use ash::vk;

use super::result::check;
use crate::error::KernelError;

/// Passes of one submission that are timed; later ones run untimed.
pub(super) const TIMED_PASSES: u32 = 4096;

/// Command pool, fence, queries and descriptor pools that recorders hand on to each other; a section keeps its own.
pub(super) struct Slot {
    pub(super) pool: vk::CommandPool,
    pub(super) level: vk::CommandBufferLevel,
    pub(super) commands: vk::CommandBuffer,
    pub(super) fence: vk::Fence,
    pub(super) queries: vk::QueryPool,
    /// Queries, from the first on, that are not in their reset state. Few submissions use many, and under validation
    /// layers a reset of all would take longer than most submissions.
    pub(super) unreset: u32,
    pub(super) descriptors: Vec<vk::DescriptorPool>,
}

impl Slot {
    /// A slot for the queues of one family.
    pub(super) fn new(
        raw: &ash::Device,
        queue_family: u32,
        level: vk::CommandBufferLevel,
    ) -> Result<Self, KernelError> {
        // SAFETY: all create infos are valid; the handles are destroyed in `destroy`.
        unsafe {
            let info = vk::CommandPoolCreateInfo::default().queue_family_index(queue_family);
            let pool = check("vkCreateCommandPool", raw.create_command_pool(&info, None))?;
            let info = vk::CommandBufferAllocateInfo::default().command_pool(pool).level(level).command_buffer_count(1);
            let commands = check("vkAllocateCommandBuffers", raw.allocate_command_buffers(&info))?[0];
            let fence = check("vkCreateFence", raw.create_fence(&vk::FenceCreateInfo::default(), None))?;
            let info =
                vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(TIMED_PASSES + 1);
            let queries = check("vkCreateQueryPool", raw.create_query_pool(&info, None))?;
            Ok(Self { pool, level, commands, fence, queries, unreset: TIMED_PASSES + 1, descriptors: Vec::new() })
        }
    }

    pub(super) fn destroy(self, device: &ash::Device) {
        // SAFETY: the last submission of this slot was waited for.
        unsafe {
            for pool in self.descriptors {
                device.destroy_descriptor_pool(pool, None);
            }
            device.destroy_query_pool(self.queries, None);
            device.destroy_fence(self.fence, None);
            device.destroy_command_pool(self.pool, None);
        }
    }
}
