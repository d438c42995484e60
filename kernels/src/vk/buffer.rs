//! Typed device buffers.

use std::marker::PhantomData;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use ash::vk;
use gpu_allocator::vulkan::Allocation;

use super::device::DeviceInner;
use super::info::HostAccess;
use super::memory::Purpose;
use super::result::check;
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

/// A range of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// First byte.
    pub(super) offset: u64,
    /// Length in bytes.
    pub(super) bytes: u64,
}

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
    pub(super) fn new(
        device: &Arc<DeviceInner>,
        name: &str,
        bytes: u64,
        purpose: Purpose,
    ) -> Result<Self, KernelError> {
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
        let allocation = match device.memory().allocate(name, handle, requirements, purpose) {
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
    pub(super) fn texels_of(&self, format: vk::Format, place: Place) -> Result<vk::BufferView, KernelError> {
        let Place { offset, bytes } = place;
        let limit = u64::from(self.device.info.max_texel_elements);
        if bytes / TEXEL_BYTES > limit {
            return Err(KernelError::Unsuitable {
                device: self.device.info.name.clone(),
                what: format!("texel buffers of {} elements (limit {limit}) for `{}`", bytes / TEXEL_BYTES, self.name),
            });
        }
        let info = vk::BufferViewCreateInfo::default().buffer(self.handle).format(format).offset(offset).range(bytes);
        // SAFETY: the buffer is bound and alive; the format is one of the mandatory texel formats; the range lies in
        // the buffer and begins at a multiple of any alignment that Vulkan lets a device ask for.
        check("vkCreateBufferView", unsafe { self.device.raw.create_buffer_view(&info, None) })
    }

    /// All of it.
    pub(super) fn whole(&self) -> Place {
        Place { offset: 0, bytes: self.bytes }
    }

    /// The whole buffer as texels of `format`, made on first use.
    pub(super) fn texel_view(&self, format: vk::Format) -> Result<vk::BufferView, KernelError> {
        if let Some(view) = self.view.get() {
            return Ok(*view);
        }
        let view = self.texels_of(format, self.whole())?;
        self.device.name_object(view, &self.name);
        if self.view.set(view).is_err() {
            // SAFETY: another thread won the race, so this view is unused.
            unsafe { self.device.raw.destroy_buffer_view(view, None) };
        }
        Ok(self.view.get().copied().unwrap_or(view))
    }

    /// Where the host sees it, if it does.
    pub(super) fn mapped(&self) -> Option<*mut u8> {
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

impl<T: Element> Buffer<T> {
    /// All of `inner` that `len` elements take.
    pub(super) fn of(inner: BufferInner, len: usize) -> Self {
        Self { inner: Arc::new(inner), first: 0, len, element: PhantomData }
    }

    /// Offset in bytes of an element in `inner`.
    pub(super) fn byte_of(&self, element: usize) -> usize {
        (self.first + element) * size_of::<T>()
    }

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
        Place { offset: bytes(self.first), bytes: bytes(self.len).next_multiple_of(TEXEL_BYTES).max(TEXEL_BYTES) }
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
}
