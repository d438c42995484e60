//! The allocator behind every buffer, with a running account of what is in use.

use ash::vk;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc};
use gpu_allocator::{AllocationError, AllocationSizes, AllocatorDebugSettings, MemoryLocation};

use super::heaps::Heaps;
use super::info::{DeviceKind, MemoryUse};
use crate::error::KernelError;

/// Buffers that an allocation error names: those that hold the most.
const NAMED_IN_ERRORS: usize = 3;
/// Blocks that a heap is cut into at least: drivers grant some four thousand allocations.
const BLOCKS_PER_HEAP: u64 = 2048;
/// Bytes of the first block, and of a later one at most; part of the last one is idle.
const BLOCK_BYTES: std::ops::RangeInclusive<u64> = 4 << 20..=64 << 20;
/// Buffers of at least this many bytes take memory of their own where the driver grants allocations enough: in blocks
/// they would leave gaps between them when some of them go, and keep blocks of which little is in use.
const OWN_BYTES: u64 = 4 << 10;
/// The same on a card, where each allocation is a call into the operating system, and gaps cost less than those.
const OWN_BYTES_OF_CARD: u64 = 1 << 20;

/// The part of a machine's free memory that a driver on its processor leaves alone, one in so many: models, films and
/// their coders need some, too.
const LEFT_TO_MACHINE: u64 = 4;

/// What a buffer is for, which decides where it lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// Kernels read and write it.
    Work,
    /// The host writes it once, the device copies from it once.
    Upload,
    /// The device copies into it, the host reads it.
    ReadBack,
}

/// Memory types for the buffers that kernels work on, as masks over `types`; the first that fits is taken, the next
/// when it is full.
///
/// Where device and processor share one memory, it should be mapped: the host then reads and writes it in place,
/// without a second buffer and a submission. It should be cached too, or host reads go to memory word by word. A card's
/// mapped memory lies behind the bus, where the host reads slower than the card copies; so on a card it comes last.
#[must_use]
pub fn work_memory(types: &[vk::MemoryType], kind: DeviceKind) -> Vec<u32> {
    use vk::MemoryPropertyFlags as Property;
    let mapped = Property::DEVICE_LOCAL | Property::HOST_VISIBLE | Property::HOST_COHERENT;
    let known = mapped | Property::HOST_CACHED;
    let is_local = |t: &&vk::MemoryType| t.property_flags.contains(Property::DEVICE_LOCAL);
    let is_shared = match kind {
        DeviceKind::Cpu | DeviceKind::Integrated => true,
        DeviceKind::Discrete => false,
        DeviceKind::Virtual | DeviceKind::Other => types
            .iter()
            .filter(is_local)
            .all(|local| types.iter().any(|t| t.heap_index == local.heap_index && t.property_flags.contains(mapped))),
    };
    // What has further properties, such as protected memory, is for those who ask for them.
    let wanted = if is_shared { vec![known, mapped, Property::DEVICE_LOCAL] } else { vec![Property::DEVICE_LOCAL] };
    let exactly = |want: Property| mask(types, |t| t.property_flags == want);
    let mut masks: Vec<u32> = wanted.into_iter().map(exactly).collect();
    let taken = masks.iter().fold(0, |all, m| all | m);
    masks.push(mask(types, |t| is_local(&t)) & !taken);
    masks.retain(|m| *m != 0);
    masks
}

fn mask(types: &[vk::MemoryType], fits: impl Fn(&vk::MemoryType) -> bool) -> u32 {
    (0..).zip(types).filter(|(_, t)| fits(t)).fold(0, |mask, (i, _): (u32, _)| mask | 1 << i)
}

pub(super) struct Memory {
    heaps: Heaps,
    allocator: Allocator,
    /// See [`work_memory`].
    work: Vec<u32>,
    used: MemoryUse,
    /// Buffers of at least so many bytes get memory of their own, others share blocks.
    own_bytes: u64,
    /// Least value of `own_bytes`.
    least_own_bytes: u64,
    /// Bytes of the largest block.
    block_bytes: u64,
    /// Allocations that may be made for single buffers.
    granted: u64,
    /// Most bytes to take from the driver that was asked for.
    budget: Option<u64>,
    /// The same where nothing was asked for: a processor's driver grants what the machine does not have.
    room: Option<u64>,
}

impl Memory {
    pub(super) fn new(instance: &ash::Instance, device: &ash::Device, heaps: Heaps) -> Result<Self, KernelError> {
        let Heaps { physical_device, kind, .. } = heaps;
        // SAFETY: the physical device belongs to the instance.
        let (properties, limits) = unsafe {
            let limits = instance.get_physical_device_properties(physical_device).limits;
            (instance.get_physical_device_memory_properties(physical_device), limits)
        };
        let work = work_memory(properties.memory_types_as_slice(), kind);
        let largest_heap = properties.memory_heaps_as_slice().iter().map(|heap| heap.size).max().unwrap_or(0);
        // The allocator wants whole multiples of 4 MiB.
        let block_bytes =
            (largest_heap / BLOCKS_PER_HEAP).next_power_of_two().clamp(*BLOCK_BYTES.start(), *BLOCK_BYTES.end());
        // Half of what the driver grants stays for blocks, whatever the heap is filled with.
        let granted = u64::from(limits.max_memory_allocation_count / 2).max(1);
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.clone(),
            device: device.clone(),
            physical_device,
            debug_settings: AllocatorDebugSettings::default(),
            buffer_device_address: false,
            allocation_sizes: AllocationSizes::new(*BLOCK_BYTES.start(), *BLOCK_BYTES.start())
                .with_max_device_memblock_size(block_bytes)
                .with_max_host_memblock_size(block_bytes),
        })
        .map_err(|e| KernelError::Allocation { name: "allocator".into(), bytes: 0, reason: e.to_string() })?;
        let used = MemoryUse::default();
        let least_own_bytes = if kind == DeviceKind::Discrete { OWN_BYTES_OF_CARD } else { OWN_BYTES };
        let free = heaps.free_bytes(&work).filter(|_| kind == DeviceKind::Cpu || heaps.supposed.is_some());
        let room = free.map(|bytes| bytes - bytes / LEFT_TO_MACHINE);
        let (own_bytes, budget) = (0, None);
        let mut memory =
            Self { heaps, allocator, work, used, own_bytes, least_own_bytes, block_bytes, granted, budget, room };
        memory.expect(largest_heap);
        Ok(memory)
    }

    /// Refuses buffers from now on for which more than `bytes` would have to be taken from the driver.
    pub(super) fn limit(&mut self, bytes: u64) {
        self.budget = Some(bytes);
        self.expect(bytes);
    }

    /// Chooses what gets memory of its own so that `bytes` in such buffers are few enough allocations.
    fn expect(&mut self, bytes: u64) {
        self.own_bytes = (bytes / self.granted).clamp(self.least_own_bytes, self.block_bytes);
    }

    /// Bytes that the driver would still give, if it tells.
    pub(super) fn free_bytes(&self) -> Option<u64> {
        self.heaps.free_bytes(&self.work)
    }

    pub(super) fn budget(&self) -> Option<u64> {
        self.budget
    }

    /// Memory for `buffer`, which has these requirements.
    pub(super) fn allocate(
        &mut self,
        name: &str,
        buffer: vk::Buffer,
        requirements: vk::MemoryRequirements,
        purpose: Purpose,
    ) -> Result<Allocation, KernelError> {
        let size = requirements.size;
        // What the host passes through comes and goes: a block that stays is cheaper than memory of its own each time.
        let own_bytes = if purpose == Purpose::Work { self.own_bytes } else { self.block_bytes };
        // A large buffer surely takes memory of its own; a small one may find room in a block that is there.
        let (held, allocation_scheme) = if size >= own_bytes {
            (self.used.reserved_bytes, AllocationScheme::DedicatedBuffer(buffer))
        } else {
            (self.used.live_bytes, AllocationScheme::GpuAllocatorManaged)
        };
        if self.is_beyond(held.saturating_add(size)) {
            return Err(self.beyond(name, size));
        }
        let (location, masks) = match purpose {
            Purpose::Work => (MemoryLocation::GpuOnly, self.work.as_slice()),
            Purpose::Upload => (MemoryLocation::CpuToGpu, [u32::MAX].as_slice()),
            Purpose::ReadBack => (MemoryLocation::GpuToCpu, [u32::MAX].as_slice()),
        };
        let mut refused = AllocationError::NoCompatibleMemoryTypeFound;
        let fitting = masks.iter().map(|mask| mask & requirements.memory_type_bits).filter(|bits| *bits != 0);
        for memory_type_bits in fitting {
            let requirements = vk::MemoryRequirements { memory_type_bits, ..requirements };
            let request = AllocationCreateDesc { name, requirements, location, linear: true, allocation_scheme };
            match self.allocator.allocate(&request) {
                Ok(allocation) => return self.account(name, allocation),
                Err(why) => refused = why,
            }
        }
        Err(self.refusal(name, size, &refused.to_string()))
    }

    /// Counts what was just taken, or gives it back where it broke the budget: whether a buffer needs a new block is
    /// known only afterwards.
    fn account(&mut self, name: &str, allocation: Allocation) -> Result<Allocation, KernelError> {
        let (size, reserved) = (allocation.size(), self.reserved());
        self.used.live_bytes += size;
        if self.is_beyond(reserved) {
            self.free(allocation);
            return Err(self.beyond(name, size));
        }
        self.used.allocations += 1;
        self.used.peak_bytes = self.used.peak_bytes.max(self.used.live_bytes);
        self.used.reserved_bytes = reserved;
        self.used.peak_reserved_bytes = self.used.peak_reserved_bytes.max(reserved);
        Ok(allocation)
    }

    /// Whether so many bytes are more than may be taken: than was asked for, or else than there is room for.
    fn is_beyond(&self, bytes: u64) -> bool {
        self.budget.or(self.room).is_some_and(|most| bytes > most)
    }

    /// Bytes taken from the driver.
    fn reserved(&self) -> u64 {
        self.allocator.capacity()
    }

    /// The error for a buffer that would take more than that.
    fn beyond(&self, name: &str, bytes: u64) -> KernelError {
        let Some(budget) = self.budget else {
            let room = self.room.unwrap_or_default();
            let whose = "three quarters of what the machine had free when the device was opened";
            return self.refusal(name, bytes, &format!("beyond {room} bytes, {whose}"));
        };
        let MemoryUse { live_bytes, reserved_bytes, .. } = self.used;
        KernelError::OverBudget { name: name.to_owned(), bytes, budget, live_bytes, reserved_bytes }
    }

    /// The error for a buffer that got no memory, with the buffers that hold the most of it.
    pub(super) fn refusal(&self, name: &str, bytes: u64, why: &str) -> KernelError {
        let mut held = self.allocator.generate_report().allocations;
        held.sort_by_key(|a| std::cmp::Reverse(a.size));
        let most = held.iter().take(NAMED_IN_ERRORS).map(|a| format!("`{}` {}", a.name, a.size));
        let most = most.collect::<Vec<_>>().join(", ");
        let reason = format!(
            "{why}; {} buffers hold {} bytes, most of them: {}",
            held.len(),
            self.used.live_bytes,
            if most.is_empty() { "none" } else { &most }
        );
        KernelError::Allocation { name: name.to_owned(), bytes, reason }
    }

    pub(super) fn free(&mut self, allocation: Allocation) {
        self.used.live_bytes -= allocation.size();
        if let Err(e) = self.allocator.free(allocation) {
            tracing::error!("freeing device memory: {e}");
        }
        self.used.reserved_bytes = self.reserved();
    }

    pub(super) fn used(&self) -> MemoryUse {
        self.used
    }
}
