//! Typed device buffers.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use ash::vk;
use gpu_allocator::vulkan::Allocation;

use super::check;
use super::device::{Device, DeviceInner, HostAccess};
use super::memory::Purpose;
use crate::error::KernelError;

/// Bytes of a texel; every buffer is padded with zeros to whole texels.
const TEXEL_BYTES: u64 = 16;

/// Element types that shaders and host share.
pub trait Element: bytemuck::Pod + std::fmt::Debug {
    /// Format of a four-component texel of this type.
    const TEXEL_FORMAT: vk::Format;
}
impl Element for f32 {
    const TEXEL_FORMAT: vk::Format = vk::Format::R32G32B32A32_SFLOAT;
}
impl Element for u32 {
    const TEXEL_FORMAT: vk::Format = vk::Format::R32G32B32A32_UINT;
}
impl Element for i32 {
    const TEXEL_FORMAT: vk::Format = vk::Format::R32G32B32A32_SINT;
}

/// The Vulkan side of a buffer; recorders keep it alive until their work is done.
pub(super) struct BufferInner {
    pub(super) device: Arc<DeviceInner>,
    pub(super) handle: vk::Buffer,
    pub(super) name: String,
    /// Bytes including the padding to whole texels.
    pub(super) bytes: u64,
    purpose: Purpose,
    allocation: Option<Allocation>,
    view: OnceLock<vk::BufferView>,
}

/// Offset and length of a range in bytes.
pub(super) type Place = (u64, u64);

/// A named array of `T` in device memory. `&Buffer` is read by a dispatch, `&mut Buffer` written.
pub struct Buffer<T> {
    pub(super) inner: Arc<BufferInner>,
    /// First element in `inner`; 0 but for a [`Buffer::part`].
    first: usize,
    len: usize,
    element: PhantomData<T>,
}

impl<T> std::fmt::Debug for Buffer<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Buffer({:?}, {} x {})", self.inner.name, self.len, std::any::type_name::<T>())
    }
}

impl BufferInner {
    fn new(device: &Arc<DeviceInner>, name: &str, bytes: u64, purpose: Purpose) -> Result<Self, KernelError> {
        let bytes = bytes.next_multiple_of(TEXEL_BYTES).max(TEXEL_BYTES);
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::STORAGE_TEXEL_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: the create info is valid and the device is alive (held by `device`).
        let handle = match unsafe { device.raw.create_buffer(&info, None) } {
            // Drivers say so already here when a buffer is larger than any memory of theirs.
            Err(code @ (vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY)) => {
                return Err(device.memory().refusal(name, bytes, &code.to_string()));
            }
            other => check("vkCreateBuffer", other)?,
        };
        // SAFETY: `handle` was just created on this device.
        let requirements = unsafe { device.raw.get_buffer_memory_requirements(handle) };
        let allocation = match device.memory().allocate(name, (handle, requirements), purpose) {
            Ok(allocation) => allocation,
            Err(e) => {
                // SAFETY: nothing has used the buffer yet.
                unsafe { device.raw.destroy_buffer(handle, None) };
                return Err(e);
            }
        };
        // SAFETY: memory and offset come from the allocator and belong to this buffer alone.
        let bound = unsafe { device.raw.bind_buffer_memory(handle, allocation.memory(), allocation.offset()) };
        let buffer = Self {
            device: Arc::clone(device),
            handle,
            name: name.to_owned(),
            bytes,
            purpose,
            allocation: Some(allocation),
            view: OnceLock::new(),
        };
        check("vkBindBufferMemory", bound)?;
        device.name_object(handle, name);
        Ok(buffer)
    }

    /// A view of some bytes as texels of `format`, which the caller destroys.
    pub(super) fn texels_of(&self, format: vk::Format, (offset, bytes): Place) -> Result<vk::BufferView, KernelError> {
        let limit = u64::from(self.device.info.max_texel_elements);
        if bytes / TEXEL_BYTES > limit {
            return Err(KernelError::Unsuitable {
                device: self.device.info.name.clone(),
                what: format!("texel buffers of {} elements (limit {limit}) for `{}`", bytes / TEXEL_BYTES, self.name),
            });
        }
        let info = vk::BufferViewCreateInfo::default().buffer(self.handle).format(format).offset(offset).range(bytes);
        // SAFETY: the buffer is bound and alive; the format is one of the mandatory texel formats; the range lies in the
        // buffer and begins at a multiple of any alignment that Vulkan lets a device ask for.
        check("vkCreateBufferView", unsafe { self.device.raw.create_buffer_view(&info, None) })
    }

    /// The whole buffer as texels of `format`, made on first use.
    pub(super) fn texel_view(&self, format: vk::Format) -> Result<vk::BufferView, KernelError> {
        if let Some(view) = self.view.get() {
            return Ok(*view);
        }
        let view = self.texels_of(format, (0, self.bytes))?;
        self.device.name_object(view, &self.name);
        if self.view.set(view).is_err() {
            // SAFETY: another thread won the race, so this view is unused.
            unsafe { self.device.raw.destroy_buffer_view(view, None) };
        }
        Ok(self.view.get().copied().unwrap_or(view))
    }

    fn mapped(&self) -> Option<*mut u8> {
        if self.purpose == Purpose::Work && self.device.host_access == HostAccess::Staged {
            return None;
        }
        let allocation = self.allocation.as_ref()?;
        let coherent = allocation.memory_properties().contains(vk::MemoryPropertyFlags::HOST_COHERENT);
        allocation.mapped_ptr().filter(|_| coherent).map(|p| p.as_ptr().cast())
    }
}

impl Drop for BufferInner {
    fn drop(&mut self) {
        // SAFETY: a recorder holds an `Arc` of every buffer it binds until its fence has signalled,
        // so the last owner drops after the device has finished with it.
        unsafe {
            if let Some(view) = self.view.take() {
                self.device.raw.destroy_buffer_view(view, None);
            }
            self.device.raw.destroy_buffer(self.handle, None);
        }
        if let Some(allocation) = self.allocation.take() {
            self.device.memory().free(allocation);
        }
    }
}

impl Device {
    /// A buffer of `len` zeros.
    ///
    /// # Errors
    /// [`KernelError::Allocation`] when memory runs out.
    pub fn buffer<T: Element>(&self, name: &str, len: usize) -> Result<Buffer<T>, KernelError> {
        self.zeros(name, len, Purpose::Work)
    }

    /// A buffer of `len` zeros for copies of what the host reads often: [`Buffer::read`] finds it mapped, so that
    /// it neither allocates nor submits. Kernels work faster in others.
    ///
    /// # Errors
    /// [`KernelError::Allocation`] when memory runs out.
    pub fn readback<T: Element>(&self, name: &str, len: usize) -> Result<Buffer<T>, KernelError> {
        self.zeros(name, len, Purpose::ReadBack)
    }

    fn zeros<T: Element>(&self, name: &str, len: usize, purpose: Purpose) -> Result<Buffer<T>, KernelError> {
        let bytes = (len * size_of::<T>()) as u64;
        let inner = Arc::new(BufferInner::new(self.inner(), name, bytes, purpose)?);
        let mut buffer = Buffer { inner, first: 0, len, element: PhantomData };
        buffer.clear()?;
        Ok(buffer)
    }

    /// A buffer holding `data`.
    ///
    /// # Errors
    /// [`KernelError::Allocation`] when memory runs out.
    pub fn buffer_from<T: Element>(&self, name: &str, data: &[T]) -> Result<Buffer<T>, KernelError> {
        let mut buffer = self.buffer(name, data.len())?;
        buffer.write(data)?;
        Ok(buffer)
    }
}

impl<T: Element> Buffer<T> {
    /// Another handle of the same memory, for kernels that read through a texel view what the same
    /// invocation then writes through a storage binding: that is several times faster on CPU drivers.
    pub(crate) fn alias(&self) -> Self {
        Self { inner: Arc::clone(&self.inner), first: self.first, len: self.len, element: PhantomData }
    }

    /// A handle of some elements only, which kernels see as a buffer of its own: for buffers that are larger than a
    /// binding may be. It begins where [`pieces`](crate::Recorder::pieces) begin.
    pub(crate) fn part(&self, elements: Range<usize>) -> Self {
        debug_assert!(elements.end <= self.len, "a part of the buffer");
        Self {
            inner: Arc::clone(&self.inner),
            first: self.first + elements.start,
            len: elements.len(),
            element: PhantomData,
        }
    }

    /// Bytes that a binding covers: whole texels.
    pub(super) fn place(&self) -> Place {
        let bytes = |elements: usize| (elements * size_of::<T>()) as u64;
        let whole = bytes(self.len).next_multiple_of(TEXEL_BYTES).max(TEXEL_BYTES);
        (bytes(self.first), whole)
    }

    /// Number of elements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it holds no element.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Name given at creation.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.inner.name
    }

    /// All elements.
    ///
    /// # Errors
    /// When the copy from device memory fails.
    pub fn read(&self) -> Result<Vec<T>, KernelError> {
        self.read_range(0..self.len)
    }

    /// Some elements.
    ///
    /// # Errors
    /// When the range leaves the buffer, or the copy from device memory fails.
    pub fn read_range(&self, range: Range<usize>) -> Result<Vec<T>, KernelError> {
        self.check_range("read", range.end)?;
        let mut out = vec![T::zeroed(); range.len()];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut out);
        let offset = (self.first + range.start) * size_of::<T>();
        if let Some(source) = self.inner.mapped() {
            // SAFETY: `source` maps the whole buffer, the range was checked, submissions are waited
            // for before anything reads, and `out` is a fresh host allocation.
            unsafe { std::ptr::copy_nonoverlapping(source.add(offset), bytes.as_mut_ptr(), bytes.len()) };
        } else if !bytes.is_empty() {
            let staging = BufferInner::new(&self.inner.device, "read-back", bytes.len() as u64, Purpose::ReadBack)?;
            let staging = Arc::new(staging);
            self.inner.device.copy_now(&self.inner, offset as u64, &staging, 0, bytes.len() as u64)?;
            let source = staging.mapped().ok_or_else(|| unmapped(&staging))?;
            // SAFETY: as above; the copy has finished and `staging` is at least as long.
            unsafe { std::ptr::copy_nonoverlapping(source, bytes.as_mut_ptr(), bytes.len()) };
        }
        Ok(out)
    }

    /// Replaces all elements.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when the lengths differ.
    pub fn write(&mut self, data: &[T]) -> Result<(), KernelError> {
        if data.len() != self.len {
            return Err(self.range_error("write", data.len()));
        }
        self.write_at(0, data)
    }

    /// Replaces the elements from `offset` on.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when the range leaves the buffer.
    pub fn write_at(&mut self, offset: usize, data: &[T]) -> Result<(), KernelError> {
        self.check_range("write", offset + data.len())?;
        self.write_bytes((self.first + offset) * size_of::<T>(), bytemuck::cast_slice(data))
    }

    fn clear(&mut self) -> Result<(), KernelError> {
        let zeros = vec![0u8; usize::try_from(self.inner.bytes).unwrap_or(usize::MAX)];
        self.write_bytes(0, &zeros)
    }

    fn write_bytes(&mut self, offset: usize, bytes: &[u8]) -> Result<(), KernelError> {
        if let Some(target) = self.inner.mapped() {
            // SAFETY: `target` maps the whole buffer and the callers checked the range; submissions
            // are waited for, so the device does not use it now.
            unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), target.add(offset), bytes.len()) };
        } else if !bytes.is_empty() {
            let staging = BufferInner::new(&self.inner.device, "upload", bytes.len() as u64, Purpose::Upload)?;
            let target = staging.mapped().ok_or_else(|| unmapped(&staging))?;
            // SAFETY: `staging` is at least `bytes.len()` long and not yet used by the device.
            unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), target, bytes.len()) };
            self.inner.device.copy_now(&Arc::new(staging), 0, &self.inner, offset as u64, bytes.len() as u64)?;
        }
        Ok(())
    }

    fn check_range(&self, what: &'static str, end: usize) -> Result<(), KernelError> {
        if end > self.len { Err(self.range_error(what, end)) } else { Ok(()) }
    }

    fn range_error(&self, what: &'static str, end: usize) -> KernelError {
        KernelError::Shape {
            kernel: "host copy",
            buffer: what,
            got: format!("{end} elements"),
            expected: format!("{} elements in `{}`", self.len, self.name()),
        }
    }
}

fn unmapped(buffer: &BufferInner) -> KernelError {
    KernelError::Allocation {
        name: buffer.name.clone(),
        bytes: buffer.bytes,
        reason: "staging memory is not host-visible".to_owned(),
    }
}
