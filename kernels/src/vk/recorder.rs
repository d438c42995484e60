//! Recording dispatches and copies with the barriers that `&` and `&mut` imply.

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use ash::vk;

use super::buffer::{Buffer, BufferInner, Element, Place};
use super::check;
use super::device::{Device, DeviceInfo, DeviceInner};
use super::family::KernelFamily;
use super::pipeline::{KernelDef, Pipeline};
use super::section::Section;
use crate::error::KernelError;

/// Descriptor sets per pool; a recorder takes as many pools as it needs and keeps them.
const SETS_PER_POOL: u32 = 256;
/// Passes of one submission that are timed; later ones run untimed.
const TIMED_PASSES: u32 = 4096;

/// Any device lets a binding begin at multiples of so many bytes: Vulkan allows no coarser alignment.
const BINDING_STRIDE: usize = 256;

/// How many workgroups to start.
#[derive(Clone, Copy, Debug)]
pub enum Grid {
    /// At least this many invocations; the shader takes its index from `global_index()`.
    Threads(usize),
    /// Exactly these workgroups.
    Groups([u32; 3]),
}

impl Grid {
    /// At least `n` invocations.
    #[must_use]
    pub fn threads(n: usize) -> Self {
        Self::Threads(n)
    }

    /// Exactly `x × y × z` workgroups.
    #[must_use]
    pub fn groups(x: u32, y: u32, z: u32) -> Self {
        Self::Groups([x, y, z])
    }

    fn resolve(self, kernel: &KernelDef, max_x: u32) -> Result<[u32; 3], KernelError> {
        let groups = match self {
            Self::Groups(groups) => groups,
            Self::Threads(n) => {
                let groups = n.div_ceil(kernel.local_size[0] as usize);
                let x = groups.min(max_x as usize);
                let y = if x == 0 { 0 } else { groups.div_ceil(x) };
                [u32::try_from(x).unwrap_or(u32::MAX), u32::try_from(y).unwrap_or(u32::MAX), 1]
            }
        };
        if groups.iter().any(|&g| g > max_x) {
            return Err(KernelError::Shape {
                kernel: kernel.name,
                buffer: "grid",
                got: format!("{groups:?} workgroups"),
                expected: format!("at most {max_x} along each axis"),
            });
        }
        Ok(groups)
    }
}

/// One buffer of a dispatch.
#[derive(Clone)]
pub struct Bound {
    pub(super) buffer: Arc<BufferInner>,
    place: Place,
    format: vk::Format,
    pub(super) writes: bool,
}

impl Bound {
    /// The shader only reads it.
    #[must_use]
    pub fn read<T: Element>(buffer: &Buffer<T>) -> Self {
        Self { buffer: Arc::clone(&buffer.inner), place: buffer.place(), format: T::TEXEL_FORMAT, writes: false }
    }

    /// The shader may write it.
    #[must_use]
    pub fn write<T: Element>(buffer: &mut Buffer<T>) -> Self {
        Self { buffer: Arc::clone(&buffer.inner), place: buffer.place(), format: T::TEXEL_FORMAT, writes: true }
    }
}

/// Implemented by every generated `Bind`.
pub trait Bindings {
    /// Push constants of the kernel.
    type Params: bytemuck::Pod;
    /// Specialisation constants of the kernel, `()` for none.
    type Spec: bytemuck::Pod;
    /// Buffers in binding order.
    type List: AsRef<[Bound]>;
    /// The kernel itself.
    fn kernel(&self) -> &'static KernelDef;
    /// Buffers in binding order.
    fn list(self) -> Self::List;
}

/// Device time of one pass.
#[derive(Clone, Debug)]
pub struct PassTime {
    /// Kernel name `family/stem`, or `copy` / `fill`.
    pub name: &'static str,
    /// Device time.
    pub time: Duration,
}

/// Device time of a submission, pass by pass.
#[derive(Clone, Debug, Default)]
pub struct Timings {
    /// Passes in order of execution.
    pub passes: Vec<PassTime>,
}

impl Timings {
    /// Sum over all passes.
    #[must_use]
    pub fn total(&self) -> Duration {
        self.passes.iter().map(|p| p.time).sum()
    }

    /// Sum over the passes of one kernel.
    #[must_use]
    pub fn of(&self, name: &str) -> Duration {
        self.passes.iter().filter(|p| p.name == name).map(|p| p.time).sum()
    }
}

/// Command pool, fence, queries and descriptor pools that recorders hand on to each other; a section keeps its own.
pub(super) struct Slot {
    pool: vk::CommandPool,
    pub(super) level: vk::CommandBufferLevel,
    pub(super) commands: vk::CommandBuffer,
    fence: vk::Fence,
    pub(super) queries: vk::QueryPool,
    /// Queries, from the first on, that are not in their reset state. Few submissions use many, and under validation
    /// layers a reset of all would take longer than most submissions.
    unreset: u32,
    descriptors: Vec<vk::DescriptorPool>,
}

impl Slot {
    pub(super) fn new(device: &DeviceInner, level: vk::CommandBufferLevel) -> Result<Self, KernelError> {
        let raw = &device.raw;
        // SAFETY: all create infos are valid; the handles are destroyed in `destroy`.
        unsafe {
            let info = vk::CommandPoolCreateInfo::default().queue_family_index(device.queue_family);
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

/// What one query is written after.
pub(super) enum Pass {
    /// A kernel, `copy` or `fill`.
    One(&'static str),
    /// All that a section holds, with queries of its own.
    Section(Section),
}

/// Time and availability that the device writes to a query.
type Query = [u64; 2];

/// A pass with the queries before and after it.
type Timed = (&'static str, [Query; 2]);

/// Records passes in order; nothing runs before [`Recorder::submit`].
pub struct Recorder {
    pub(super) device: Arc<DeviceInner>,
    slot: Option<Slot>,
    sets_used: u32,
    /// What passes touch, kept alive until the fence has signalled.
    pub(super) bounds: Vec<Bound>,
    /// Views of parts of them, destroyed with the recorder.
    views: Vec<vk::BufferView>,
    pipelines: Vec<Arc<Pipeline>>,
    passes: Vec<Pass>,
    unsynced_reads: HashSet<vk::Buffer>,
    unsynced_writes: HashSet<vk::Buffer>,
}

impl Device {
    /// A recorder with nothing in it.
    ///
    /// # Errors
    /// When the device refuses a command buffer.
    pub fn recorder(&self) -> Result<Recorder, KernelError> {
        Recorder::new(self.inner())
    }
}

impl Recorder {
    pub(super) fn new(device: &Arc<DeviceInner>) -> Result<Self, KernelError> {
        let spare = device.slots.lock().expect("no panic happens while slots are locked").pop();
        let slot = match spare {
            Some(slot) => slot,
            None => Slot::new(device, vk::CommandBufferLevel::PRIMARY)?,
        };
        Self::begin(device, slot)
    }

    pub(super) fn begin(device: &Arc<DeviceInner>, slot: Slot) -> Result<Self, KernelError> {
        use vk::CommandBufferUsageFlags as Usage;
        let is_section = slot.level == vk::CommandBufferLevel::SECONDARY;
        let usage = if is_section { Usage::SIMULTANEOUS_USE } else { Usage::ONE_TIME_SUBMIT };
        let inherited = vk::CommandBufferInheritanceInfo::default();
        let info = vk::CommandBufferBeginInfo::default().flags(usage).inheritance_info(&inherited);
        // SAFETY: a spare slot's work has finished, so its pools may be reset.
        unsafe {
            let raw = &device.raw;
            check("vkResetCommandPool", raw.reset_command_pool(slot.pool, vk::CommandPoolResetFlags::empty()))?;
            for &pool in &slot.descriptors {
                check("vkResetDescriptorPool", raw.reset_descriptor_pool(pool, vk::DescriptorPoolResetFlags::empty()))?;
            }
            check("vkBeginCommandBuffer", raw.begin_command_buffer(slot.commands, &info))?;
            // Before a section others may still run; and it does not know yet how many queries it needs.
            let mut stage = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
            if !is_section {
                stage = vk::PipelineStageFlags::TOP_OF_PIPE;
                raw.cmd_reset_query_pool(slot.commands, slot.queries, 0, slot.unreset);
            }
            raw.cmd_write_timestamp(slot.commands, stage, slot.queries, 0);
        }
        Ok(Self {
            device: Arc::clone(device),
            slot: Some(slot),
            sets_used: 0,
            bounds: Vec::new(),
            views: Vec::new(),
            pipelines: Vec::new(),
            passes: Vec::new(),
            unsynced_reads: HashSet::new(),
            unsynced_writes: HashSet::new(),
        })
    }

    /// Which kernels the device runs; a wrapper that has a program for each asks this.
    pub(crate) fn family(&self) -> KernelFamily {
        self.device.family
    }

    pub(super) fn info(&self) -> &DeviceInfo {
        &self.device.info
    }

    /// Records a kernel without specialisation constants.
    ///
    /// # Errors
    /// When the grid exceeds the device's limit, or a pipeline or descriptor cannot be made.
    pub fn dispatch<B: Bindings<Spec = ()>>(
        &mut self,
        bind: B,
        params: B::Params,
        grid: Grid,
    ) -> Result<(), KernelError> {
        self.dispatch_spec(bind, params, (), grid)
    }

    /// Records a kernel with specialisation constants. An empty grid records nothing.
    ///
    /// # Errors
    /// As [`Recorder::dispatch`].
    pub fn dispatch_spec<B: Bindings>(
        &mut self,
        bind: B,
        params: B::Params,
        spec: B::Spec,
        grid: Grid,
    ) -> Result<(), KernelError> {
        let kernel = bind.kernel();
        let groups = grid.resolve(kernel, self.device.info.max_groups_x)?;
        if groups.contains(&0) {
            return Ok(());
        }
        let pipeline = self.device.pipelines.get(&self.device.raw, kernel, bytemuck::bytes_of(&spec))?;
        let list = bind.list();
        self.synchronise(list.as_ref());
        let set = self.descriptor_set(kernel, &pipeline, list.as_ref())?;
        let commands = self.slot().commands;
        // SAFETY: recording is open; pipeline, set and buffers are kept alive until the fence.
        unsafe {
            let raw = &self.device.raw;
            raw.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.handle);
            raw.cmd_bind_descriptor_sets(commands, vk::PipelineBindPoint::COMPUTE, pipeline.layout, 0, &[set], &[]);
            if kernel.params_bytes > 0 {
                let bytes = bytemuck::bytes_of(&params);
                raw.cmd_push_constants(commands, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, bytes);
            }
            raw.cmd_dispatch(commands, groups[0], groups[1], groups[2]);
        }
        self.pipelines.push(pipeline);
        self.end_pass(Pass::One(kernel.name));
        Ok(())
    }

    /// Sets every element to `value`.
    pub fn fill<T: Element>(&mut self, buffer: &mut Buffer<T>, value: T) {
        let bound = [Bound::write(buffer)];
        self.synchronise(&bound);
        let bits = bytemuck::cast(value_bytes(value));
        let (offset, bytes) = buffer.place();
        // SAFETY: recording is open; the buffer is kept alive until the fence.
        unsafe {
            self.device.raw.cmd_fill_buffer(self.slot().commands, buffer.inner.handle, offset, bytes, bits);
        }
        self.end_pass(Pass::One("fill"));
    }

    /// Copies `len` elements.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when a range leaves its buffer.
    pub fn copy<T: Element>(
        &mut self,
        from: &Buffer<T>,
        from_offset: usize,
        to: &mut Buffer<T>,
        to_offset: usize,
        len: usize,
    ) -> Result<(), KernelError> {
        for (buffer, end) in [(from, from_offset + len), (&*to, to_offset + len)] {
            if end > buffer.len() {
                return Err(KernelError::Shape {
                    kernel: "copy",
                    buffer: "range",
                    got: format!("{end} elements"),
                    expected: format!("{} elements in `{}`", buffer.len(), buffer.name()),
                });
            }
        }
        if len > 0 {
            let size = size_of::<T>();
            let region = vk::BufferCopy {
                src_offset: from.place().0 + (from_offset * size) as u64,
                dst_offset: to.place().0 + (to_offset * size) as u64,
                size: (len * size) as u64,
            };
            self.copy_region(&from.inner, &to.inner, region);
        }
        Ok(())
    }

    pub(super) fn copy_region(&mut self, from: &Arc<BufferInner>, to: &Arc<BufferInner>, region: vk::BufferCopy) {
        let format = vk::Format::UNDEFINED;
        self.synchronise(&[
            Bound { buffer: Arc::clone(from), place: (0, from.bytes), format, writes: false },
            Bound { buffer: Arc::clone(to), place: (0, to.bytes), format, writes: true },
        ]);
        // SAFETY: recording is open; ranges were checked; both buffers are kept until the fence.
        unsafe { self.device.raw.cmd_copy_buffer(self.slot().commands, from.handle, to.handle, &[region]) };
        self.end_pass(Pass::One("copy"));
    }

    /// Forgets what earlier passes touched, so that the next one gets no barrier: a fault on purpose, for trying whether
    /// the validation layers see it.
    #[cfg(feature = "validation")]
    pub fn forget_accesses(&mut self) {
        self.unsynced_reads.clear();
        self.unsynced_writes.clear();
    }

    /// Runs what was recorded, waits for it, and returns the device time of each pass.
    ///
    /// # Errors
    /// [`KernelError::DeviceLost`] naming the last pass that finished; [`KernelError::Shape`] for a section's recorder.
    pub fn submit(mut self) -> Result<Timings, KernelError> {
        self.expect_level(vk::CommandBufferLevel::PRIMARY)?;
        let (commands, fence) = (self.slot().commands, self.slot().fence);
        let barrier = [vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::HOST_READ)];
        // SAFETY: recording is open and ends here; everything recorded is kept alive by `self`.
        let ended = unsafe {
            self.device.raw.cmd_pipeline_barrier(
                commands,
                vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER,
                vk::PipelineStageFlags::HOST,
                vk::DependencyFlags::empty(),
                &barrier,
                &[],
                &[],
            );
            check("vkEndCommandBuffer", self.device.raw.end_command_buffer(commands))
        };
        let done = ended.and_then(|()| self.device.submit_and_wait(commands, fence));
        match done {
            Ok(()) => {
                self.slot_mut().unreset = u32::try_from(self.timed() + 1).unwrap_or(TIMED_PASSES + 1);
                self.timings()
            }
            Err(KernelError::DeviceLost { .. }) => Err(KernelError::DeviceLost { last_pass: self.last_finished() }),
            Err(other) => Err(other),
        }
    }

    /// Passes with a query of their own.
    pub(super) fn timed(&self) -> usize {
        self.passes.len().min(TIMED_PASSES as usize)
    }

    /// Names of the timed passes, those in sections among them, each with the queries before and after it.
    fn queries(&self) -> (Vec<Timed>, Result<(), KernelError>) {
        let mut results: Vec<Query> = vec![[0; 2]; self.timed() + 1];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WITH_AVAILABILITY;
        // SAFETY: the query pool is alive, and the submission that reset and wrote the queries was waited for; on a lost
        // device the call returns what is there.
        let got = unsafe { self.device.raw.get_query_pool_results(self.slot().queries, 0, &mut results, flags) };
        let mut outcome = check("vkGetQueryPoolResults", got);
        let mut passes = Vec::with_capacity(results.len());
        for (pass, pair) in self.passes.iter().zip(results.windows(2)) {
            match pass {
                Pass::One(name) => passes.push((*name, [pair[0], pair[1]])),
                Pass::Section(section) => {
                    let (inner, got) = section.recorder().queries();
                    passes.extend(inner);
                    outcome = outcome.and(got);
                }
            }
        }
        (passes, outcome)
    }

    fn timings(&self) -> Result<Timings, KernelError> {
        let (queries, outcome) = self.queries();
        outcome?;
        let period = f64::from(self.device.info.timestamp_period_ns);
        let time = |[before, after]: [Query; 2]| {
            Duration::from_secs_f64(after[0].saturating_sub(before[0]) as f64 * period * 1e-9)
        };
        let passes: Vec<_> = queries.into_iter().map(|(name, pair)| PassTime { name, time: time(pair) }).collect();
        for PassTime { name, time } in &passes {
            tracing::trace!(pass = name, us = time.as_secs_f64() * 1e6, "ran");
        }
        Ok(Timings { passes })
    }

    /// The last pass whose timestamp arrived, for the report of a lost device.
    fn last_finished(&self) -> String {
        let (queries, _) = self.queries();
        // Nobody asks for the one from before the first pass.
        let available: Vec<u64> = std::iter::once(0).chain(queries.iter().map(|(_, [_, after])| after[1])).collect();
        last_finished(&available, &self.names())
    }

    /// All passes, also those that are not timed.
    fn names(&self) -> Vec<&'static str> {
        let names = |pass: &Pass| match pass {
            Pass::One(name) => vec![*name],
            Pass::Section(section) => section.recorder().names(),
        };
        self.passes.iter().flat_map(names).collect()
    }

    pub(super) fn slot(&self) -> &Slot {
        self.slot.as_ref().expect("only drop takes the slot")
    }

    fn slot_mut(&mut self) -> &mut Slot {
        self.slot.as_mut().expect("only drop takes the slot")
    }

    /// Emits a barrier when a buffer was touched since the last one in a way that conflicts.
    pub(super) fn synchronise(&mut self, list: &[Bound]) {
        let conflict = list.iter().any(|b| {
            let handle = b.buffer.handle;
            self.unsynced_writes.contains(&handle) || (b.writes && self.unsynced_reads.contains(&handle))
        });
        if conflict {
            use vk::AccessFlags as Access;
            let writes = Access::SHADER_WRITE | Access::TRANSFER_WRITE;
            let barrier = [vk::MemoryBarrier::default()
                .src_access_mask(writes)
                .dst_access_mask(writes | Access::SHADER_READ | Access::TRANSFER_READ)];
            let stages = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER;
            // SAFETY: recording is open.
            unsafe {
                self.device.raw.cmd_pipeline_barrier(
                    self.slot().commands,
                    stages,
                    stages,
                    vk::DependencyFlags::empty(),
                    &barrier,
                    &[],
                    &[],
                );
            }
            self.unsynced_reads.clear();
            self.unsynced_writes.clear();
        }
        for b in list {
            let touched = if b.writes { &mut self.unsynced_writes } else { &mut self.unsynced_reads };
            touched.insert(b.buffer.handle);
            self.bounds.push(b.clone());
        }
    }

    pub(super) fn end_pass(&mut self, pass: Pass) {
        self.passes.push(pass);
        if let Ok(query @ ..=TIMED_PASSES) = u32::try_from(self.passes.len()) {
            let slot = self.slot();
            // SAFETY: recording is open and the query was reset at its start.
            unsafe {
                self.device.raw.cmd_write_timestamp(
                    slot.commands,
                    vk::PipelineStageFlags::BOTTOM_OF_PIPE,
                    slot.queries,
                    query,
                );
            }
        }
    }

    fn descriptor_set(
        &mut self,
        kernel: &'static KernelDef,
        pipeline: &Pipeline,
        list: &[Bound],
    ) -> Result<vk::DescriptorSet, KernelError> {
        let pool = self.descriptor_pool()?;
        let layouts = [pipeline.set_layout];
        let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
        // SAFETY: the pool has room (counted in `descriptor_pool`).
        let set = check("vkAllocateDescriptorSets", unsafe { self.device.raw.allocate_descriptor_sets(&info) })?[0];
        let limit = u64::from(self.device.info.max_storage_bytes);
        for (def, bound) in kernel.bindings.iter().zip(list) {
            let (offset, bytes) = bound.place;
            let buffers = [vk::DescriptorBufferInfo::default().buffer(bound.buffer.handle).offset(offset).range(bytes)];
            let descriptor_type = def.kind.descriptor_type(self.device.family);
            let write =
                vk::WriteDescriptorSet::default().dst_set(set).dst_binding(def.number).descriptor_type(descriptor_type);
            let views;
            let write = if descriptor_type == vk::DescriptorType::STORAGE_BUFFER {
                if bytes > limit {
                    return Err(too_large(kernel.name, def.name, bound, limit));
                }
                write.buffer_info(&buffers)
            } else {
                views = [self.texels(bound)?];
                write.texel_buffer_view(&views)
            };
            // SAFETY: the set is not in use yet and the infos live through the call.
            unsafe { self.device.raw.update_descriptor_sets(&[write], &[]) };
        }
        Ok(set)
    }

    /// What a texel binding shows: the buffer, or a part of it that is only viewed this once.
    fn texels(&mut self, bound: &Bound) -> Result<vk::BufferView, KernelError> {
        if bound.place == (0, bound.buffer.bytes) {
            return bound.buffer.texel_view(bound.format);
        }
        let view = bound.buffer.texels_of(bound.format, bound.place)?;
        self.views.push(view);
        Ok(view)
    }

    /// Splits `rows` rows of at most `row_bytes` each into ranges of which a storage binding can hold one: a single one where it
    /// can hold all. Kernels that look at one row at a time run once for each, on [`Buffer::part`]s.
    pub(crate) fn pieces(&self, rows: usize, row_bytes: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let most = self.device.info.max_storage_bytes as usize / row_bytes;
        // So many rows fill whole strides.
        let step = BINDING_STRIDE >> row_bytes.trailing_zeros().min(BINDING_STRIDE.trailing_zeros());
        let piece = if most >= rows { rows.max(1) } else { (most / step).max(1) * step };
        (0..rows.max(1)).step_by(piece).map(move |first| first..(first + piece).min(rows))
    }

    /// The pool with room for one more set.
    fn descriptor_pool(&mut self) -> Result<vk::DescriptorPool, KernelError> {
        let index = (self.sets_used / SETS_PER_POOL) as usize;
        self.sets_used += 1;
        if let Some(&pool) = self.slot().descriptors.get(index) {
            return Ok(pool);
        }
        let size = |ty| vk::DescriptorPoolSize { ty, descriptor_count: SETS_PER_POOL * 8 };
        let sizes = [size(vk::DescriptorType::STORAGE_BUFFER), size(vk::DescriptorType::STORAGE_TEXEL_BUFFER)];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(SETS_PER_POOL).pool_sizes(&sizes);
        // SAFETY: the create info is valid; the slot destroys the pool.
        let pool = check("vkCreateDescriptorPool", unsafe { self.device.raw.create_descriptor_pool(&info, None) })?;
        self.slot_mut().descriptors.push(pool);
        Ok(pool)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        for view in self.views.drain(..) {
            // SAFETY: it was made on this device, and nothing that was recorded with it runs any more.
            unsafe { self.device.raw.destroy_buffer_view(view, None) };
        }
        match self.slot.take() {
            // Whoever replays a section keeps it until the fence has signalled.
            Some(slot) if slot.level == vk::CommandBufferLevel::SECONDARY => slot.destroy(&self.device.raw),
            Some(slot) => self.device.slots.lock().expect("no panic happens while slots are locked").push(slot),
            None => {}
        }
    }
}

/// The last of `passes` that finished, by the availability words of the timestamps: one from before the first pass, then
/// one from after each pass that is timed. Passes run in order, so the first word that is zero ends the search.
#[must_use]
pub fn last_finished(available: &[u64], passes: &[&str]) -> String {
    let timed = available.len().saturating_sub(1);
    let finished = available.iter().skip(1).take_while(|word| **word != 0).count();
    let Some(name) = finished.checked_sub(1).and_then(|last| passes.get(last)) else { return "none".to_owned() };
    let place = format!("`{name}`, pass {finished} of {}", passes.len());
    if finished == timed && timed < passes.len() {
        return format!("{place}, or one after it: later passes have no timestamp");
    }
    place
}

fn value_bytes<T: Element>(value: T) -> [u8; 4] {
    let mut bytes = [0; 4];
    bytes.copy_from_slice(bytemuck::bytes_of(&value));
    bytes
}

fn too_large(kernel: &'static str, buffer: &'static str, bound: &Bound, limit: u64) -> KernelError {
    KernelError::Shape {
        kernel,
        buffer,
        got: format!("`{}` of {} bytes", bound.buffer.name, bound.place.1),
        expected: format!("at most {limit} bytes in one storage binding"),
    }
}
