//! Recording dispatches and copies with the barriers that `&` and `&mut` imply.

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::bound::{Bindings, Bound};
use super::grid::Grid;
use super::recording::{Label, Pass, Recording};
use super::timings::Timings;
use crate::error::KernelError;
use crate::vk::buffer::{Buffer, BufferInner, Element, Place};
use crate::vk::cooperation::Cooperation;
use crate::vk::device::{Device, DeviceInner};
use crate::vk::family::KernelFamily;
use crate::vk::result::check;
use crate::vk::slot::{Slot, TIMED_PASSES};

/// Any device lets a binding begin at multiples of so many bytes: Vulkan allows no coarser alignment.
const BINDING_STRIDE: usize = 256;

/// Records passes in order; nothing runs before [`Recorder::submit`].
pub struct Recorder {
    pub(super) recording: Recording,
    /// Innermost part that is being recorded.
    part: Option<&'static str>,
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
    fn new(device: &Arc<DeviceInner>) -> Result<Self, KernelError> {
        let spare = device.slots.lock().expect("no panic happens while slots are locked").pop();
        let slot = match spare {
            Some(slot) => slot,
            None => Slot::new(&device.raw, device.queue_family, vk::CommandBufferLevel::PRIMARY)?,
        };
        Self::begin(device, slot)
    }

    /// A recorder of a slot's commands.
    pub(super) fn begin(device: &Arc<DeviceInner>, slot: Slot) -> Result<Self, KernelError> {
        Ok(Self {
            recording: Recording::begin(device, slot)?,
            part: None,
            unsynced_reads: HashSet::new(),
            unsynced_writes: HashSet::new(),
        })
    }

    pub(in crate::vk) fn device(&self) -> &Arc<DeviceInner> {
        &self.recording.device
    }

    fn commands(&self) -> vk::CommandBuffer {
        self.recording.slot().commands
    }

    /// Which kernels the device runs; a wrapper that has a program for each asks this.
    pub(crate) fn family(&self) -> KernelFamily {
        self.device().family
    }

    /// As [`Device::cooperation`].
    pub(crate) fn cooperation(&self) -> Result<Cooperation, KernelError> {
        self.device().info.needed_cooperation()
    }

    /// Records passes as one part of the work, which their [`PassTime`](super::PassTime)s then name. Of parts within
    /// parts the innermost counts. A section keeps the parts that it was recorded with; its passes that have none get
    /// those of the place where it is replayed.
    ///
    /// The name is the caller's: what a kernel's time is spent on is known where it is recorded, not by its name.
    pub fn part<R>(&mut self, name: &'static str, record: impl FnOnce(&mut Self) -> R) -> R {
        let outer = self.part.replace(name);
        let result = record(self);
        self.part = outer;
        result
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
        let groups = grid.resolve(kernel, self.device().info.max_groups_x)?;
        if groups.contains(&0) {
            return Ok(());
        }
        let pipeline = self.device().pipelines.get(&self.device().raw, kernel, bytemuck::bytes_of(&spec))?;
        let list = bind.list();
        self.synchronise(list.as_ref());
        let set = self.recording.descriptor_set(kernel, &pipeline, list.as_ref())?;
        let commands = self.commands();
        // SAFETY: recording is open; pipeline, set and buffers are kept alive until the fence.
        unsafe {
            let raw = &self.device().raw;
            raw.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.handle);
            raw.cmd_bind_descriptor_sets(commands, vk::PipelineBindPoint::COMPUTE, pipeline.layout, 0, &[set], &[]);
            if kernel.params_bytes > 0 {
                let bytes = bytemuck::bytes_of(&params);
                raw.cmd_push_constants(commands, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, bytes);
            }
            raw.cmd_dispatch(commands, groups[0], groups[1], groups[2]);
        }
        self.recording.pipelines.push(pipeline);
        self.end_pass(kernel.name);
        Ok(())
    }

    /// Sets every element to `value`.
    pub fn fill<T: Element>(&mut self, buffer: &mut Buffer<T>, value: T) {
        self.fill_place(&buffer.inner, buffer.place(), bytemuck::cast(value_bytes(value)));
    }

    /// Zeroes a whole buffer.
    pub(in crate::vk) fn zero(&mut self, buffer: &Arc<BufferInner>) {
        self.fill_place(buffer, buffer.whole(), 0);
    }

    fn fill_place(&mut self, buffer: &Arc<BufferInner>, place: Place, bits: u32) {
        let format = vk::Format::UNDEFINED;
        self.synchronise(&[Bound { buffer: Arc::clone(buffer), place, format, writes: true }]);
        // SAFETY: recording is open; the buffer is kept alive until the fence.
        unsafe {
            let raw = &self.device().raw;
            raw.cmd_fill_buffer(self.commands(), buffer.handle, place.offset, place.bytes, bits);
        }
        self.end_pass("fill");
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
                src_offset: from.place().offset + (from_offset * size) as u64,
                dst_offset: to.place().offset + (to_offset * size) as u64,
                size: (len * size) as u64,
            };
            self.copy_region(&from.inner, &to.inner, region);
        }
        Ok(())
    }

    fn copy_region(&mut self, from: &Arc<BufferInner>, to: &Arc<BufferInner>, region: vk::BufferCopy) {
        let format = vk::Format::UNDEFINED;
        self.synchronise(&[
            Bound { buffer: Arc::clone(from), place: from.whole(), format, writes: false },
            Bound { buffer: Arc::clone(to), place: to.whole(), format, writes: true },
        ]);
        // SAFETY: recording is open; ranges were checked; both buffers are kept until the fence.
        unsafe { self.device().raw.cmd_copy_buffer(self.commands(), from.handle, to.handle, &[region]) };
        self.end_pass("copy");
    }

    /// Forgets what earlier passes touched, so that the next one gets no barrier: a fault on purpose, for trying
    /// whether the validation layers see it.
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
        let (commands, fence) = (self.commands(), self.recording.slot().fence);
        let barrier = [vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::HOST_READ)];
        // SAFETY: recording is open and ends here; everything recorded is kept alive by `self`.
        let ended = unsafe {
            self.device().raw.cmd_pipeline_barrier(
                commands,
                vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER,
                vk::PipelineStageFlags::HOST,
                vk::DependencyFlags::empty(),
                &barrier,
                &[],
                &[],
            );
            check("vkEndCommandBuffer", self.device().raw.end_command_buffer(commands))
        };
        let done = ended.and_then(|()| self.device().submit_and_wait(commands, fence));
        match done {
            Ok(()) => {
                self.recording.slot_mut().unreset =
                    u32::try_from(self.recording.timed() + 1).unwrap_or(TIMED_PASSES + 1);
                self.recording.timings()
            }
            Err(KernelError::DeviceLost { .. }) => {
                Err(KernelError::DeviceLost { last_pass: self.recording.last_finished() })
            }
            Err(other) => Err(other),
        }
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
                self.device().raw.cmd_pipeline_barrier(
                    self.commands(),
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
            self.recording.bounds.push(b.clone());
        }
    }

    fn end_pass(&mut self, name: &'static str) {
        self.recording.end(Pass::One(Label { name, part: self.part }));
    }

    /// The pass of a section that was just executed.
    pub(super) fn end_section(&mut self, section: &Arc<Recording>) {
        self.recording.end(Pass::Section(Arc::clone(section), self.part));
    }

    /// Refuses what the recorder's command buffer cannot do: a section's is not submitted and runs no other.
    pub(in crate::vk) fn expect_level(&self, level: vk::CommandBufferLevel) -> Result<(), KernelError> {
        match (self.recording.slot().level, level) {
            (got, expected) if got == expected => Ok(()),
            (vk::CommandBufferLevel::SECONDARY, _) => Err(misused("that of a section", "one of its own")),
            _ => Err(misused("one of its own", "that of a section")),
        }
    }

    /// Splits `rows` rows of at most `row_bytes` each into ranges of which a storage binding can hold one: a single one
    /// where it can hold all. Kernels that look at one row at a time run once for each, on [`Buffer::part`]s.
    pub(crate) fn pieces(&self, rows: usize, row_bytes: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let most = self.device().info.max_storage_bytes as usize / row_bytes;
        // So many rows fill whole strides.
        let step = BINDING_STRIDE >> row_bytes.trailing_zeros().min(BINDING_STRIDE.trailing_zeros());
        let piece = if most >= rows { rows.max(1) } else { (most / step).max(1) * step };
        (0..rows.max(1)).step_by(piece).map(move |first| first..(first + piece).min(rows))
    }
}

/// Copies bytes between buffers of one device in a submission of its own.
pub(crate) fn copy_now(
    from: &Arc<BufferInner>,
    to: &Arc<BufferInner>,
    region: vk::BufferCopy,
) -> Result<(), KernelError> {
    let mut recorder = Recorder::new(&from.device)?;
    recorder.copy_region(from, to, region);
    recorder.submit().map(drop)
}

/// Zeroes a whole buffer in a submission of its own.
pub(crate) fn zero_now(buffer: &Arc<BufferInner>) -> Result<(), KernelError> {
    let mut recorder = Recorder::new(&buffer.device)?;
    recorder.zero(buffer);
    recorder.submit().map(drop)
}

fn value_bytes<T: Element>(value: T) -> [u8; 4] {
    let mut bytes = [0; 4];
    bytes.copy_from_slice(bytemuck::bytes_of(&value));
    bytes
}

pub(super) fn misused(got: &str, expected: &str) -> KernelError {
    KernelError::Shape { kernel: "section", buffer: "recorder", got: got.to_owned(), expected: expected.to_owned() }
}
