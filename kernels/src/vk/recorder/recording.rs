//! A command buffer that is being filled or has been, with all that it needs until it has run.

use std::sync::Arc;
use std::time::Duration;

use ash::vk;

use super::bound::Bound;
use super::timings::{self, PassTime, Timings};
use crate::error::KernelError;
use crate::vk::buffer::Place;
use crate::vk::device::DeviceInner;
use crate::vk::pipeline::{KernelDef, Pipeline};
use crate::vk::result::check;
use crate::vk::slot::{Slot, TIMED_PASSES};

/// Descriptor sets per pool; a recording takes as many pools as it needs, and its slot keeps them.
const SETS_PER_POOL: u32 = 256;

/// What a pass is called.
#[derive(Clone, Copy)]
pub(super) struct Label {
    /// A kernel, `copy` or `fill`.
    pub(super) name: &'static str,
    /// The part of the work that it was recorded in.
    pub(super) part: Option<&'static str>,
}

/// What one query is written after.
pub(super) enum Pass {
    /// A kernel, `copy` or `fill`.
    One(Label),
    /// All that a section holds, with queries of its own, and the part in which it is replayed.
    Section(Arc<Recording>, Option<&'static str>),
}

/// Time and availability that the device writes to a query.
type Query = [u64; 2];

/// A pass with the queries before and after it.
type Timed = (Label, [Query; 2]);

/// The commands of a slot, and what keeps them runnable.
pub(super) struct Recording {
    pub(super) device: Arc<DeviceInner>,
    slot: Option<Slot>,
    sets_used: u32,
    /// What passes touch, kept alive until the fence has signalled.
    pub(super) bounds: Vec<Bound>,
    /// Views of parts of them, destroyed with the recording.
    views: Vec<vk::BufferView>,
    pub(super) pipelines: Vec<Arc<Pipeline>>,
    passes: Vec<Pass>,
}

impl Recording {
    /// Opens a slot's command buffer.
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
        })
    }

    pub(super) fn slot(&self) -> &Slot {
        self.slot.as_ref().expect("only drop takes the slot")
    }

    pub(super) fn slot_mut(&mut self) -> &mut Slot {
        self.slot.as_mut().expect("only drop takes the slot")
    }

    /// Ends a pass with a query of its own.
    pub(super) fn end(&mut self, pass: Pass) {
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

    /// Passes with a query of their own.
    pub(super) fn timed(&self) -> usize {
        self.passes.len().min(TIMED_PASSES as usize)
    }

    /// Names of the timed passes, those in sections among them, each with the queries before and after it.
    fn queries(&self) -> (Vec<Timed>, Result<(), KernelError>) {
        let mut results: Vec<Query> = vec![[0; 2]; self.timed() + 1];
        let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WITH_AVAILABILITY;
        // SAFETY: the query pool is alive, and the submission that reset and wrote the queries was waited for; on a
        // lost device the call returns what is there.
        let got = unsafe { self.device.raw.get_query_pool_results(self.slot().queries, 0, &mut results, flags) };
        let mut outcome = check("vkGetQueryPoolResults", got);
        let mut passes = Vec::with_capacity(results.len());
        for (pass, pair) in self.passes.iter().zip(results.windows(2)) {
            match pass {
                Pass::One(label) => passes.push((*label, [pair[0], pair[1]])),
                Pass::Section(section, part) => {
                    let (inner, got) = section.queries();
                    let within = |label: Label| Label { part: label.part.or(*part), ..label };
                    passes.extend(inner.into_iter().map(|(label, pair)| (within(label), pair)));
                    outcome = outcome.and(got);
                }
            }
        }
        (passes, outcome)
    }

    /// Device time of each pass, once a submission has been waited for.
    pub(super) fn timings(&self) -> Result<Timings, KernelError> {
        let (queries, outcome) = self.queries();
        outcome?;
        let period = f64::from(self.device.info.timestamp_period_ns);
        let time = |[before, after]: [Query; 2]| {
            Duration::from_secs_f64(after[0].saturating_sub(before[0]) as f64 * period * 1e-9)
        };
        let timed = |(Label { name, part }, pair)| PassTime { name, part, time: time(pair) };
        let passes: Vec<_> = queries.into_iter().map(timed).collect();
        for PassTime { name, part, time } in &passes {
            tracing::trace!(pass = name, part, us = time.as_secs_f64() * 1e6, "ran");
        }
        Ok(Timings { passes })
    }

    /// The last pass whose timestamp arrived, for the report of a lost device.
    pub(super) fn last_finished(&self) -> String {
        let (queries, _) = self.queries();
        // Nobody asks for the one from before the first pass.
        let available: Vec<u64> = std::iter::once(0).chain(queries.iter().map(|(_, [_, after])| after[1])).collect();
        timings::last_finished(&available, &self.names())
    }

    /// All passes, also those that are not timed.
    fn names(&self) -> Vec<&'static str> {
        let names = |pass: &Pass| match pass {
            Pass::One(label) => vec![label.name],
            Pass::Section(section, _) => section.names(),
        };
        self.passes.iter().flat_map(names).collect()
    }

    /// What a kernel's pass binds.
    pub(super) fn descriptor_set(
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
            let Place { offset, bytes } = bound.place;
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
        if bound.place == bound.buffer.whole() {
            return bound.buffer.texel_view(bound.format);
        }
        let view = bound.buffer.texels_of(bound.format, bound.place)?;
        self.views.push(view);
        Ok(view)
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

impl Drop for Recording {
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

fn too_large(kernel: &'static str, buffer: &'static str, bound: &Bound, limit: u64) -> KernelError {
    KernelError::Shape {
        kernel,
        buffer,
        got: format!("`{}` of {} bytes", bound.buffer.name, bound.place.bytes),
        expected: format!("at most {limit} bytes in one storage binding"),
    }
}
