//! What the host puts into buffers and reads out of them.

use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::buffer::{Buffer, BufferInner, Element};
use super::device::Device;
use super::memory::Purpose;
use super::recorder::{Recorder, copy_now, zero_now};
use crate::error::KernelError;

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
        let buffer = Buffer::of(BufferInner::new(self.inner(), name, bytes, purpose)?, len);
        buffer.clear()?;
        Ok(buffer)
    }

    /// A buffer holding `data`.
    ///
    /// # Errors
    /// [`KernelError::Allocation`] when memory runs out.
    pub fn buffer_from<T: Element>(&self, name: &str, data: &[T]) -> Result<Buffer<T>, KernelError> {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let mut buffer =
            Buffer::of(BufferInner::new(self.inner(), name, bytes.len() as u64, Purpose::Work)?, data.len());
        if bytes.len() as u64 == buffer.inner.bytes {
            buffer.write_bytes(0, bytes)?;
        } else {
            // The padding to whole texels stays zero.
            let mut padded = bytes.to_vec();
            padded.resize(usize::try_from(buffer.inner.bytes).unwrap_or(usize::MAX), 0);
            buffer.write_bytes(0, &padded)?;
        }
        Ok(buffer)
    }
}

impl Recorder {
    /// As [`Device::buffer`], for passes of this recorder: what has to be zeroed on the device is zeroed by a pass, and
    /// [`Device::buffer`] submits one and waits. So until the recorder has run, the host finds anything in it.
    ///
    /// # Errors
    /// [`KernelError::Allocation`] when memory runs out; [`KernelError::Shape`] for a section's recorder, which would
    /// zero the buffer whenever it is replayed.
    pub fn zeros<T: Element>(&mut self, name: &str, len: usize) -> Result<Buffer<T>, KernelError> {
        self.expect_level(vk::CommandBufferLevel::PRIMARY)?;
        let bytes = (len * size_of::<T>()) as u64;
        let buffer = Buffer::<T>::of(BufferInner::new(self.device(), name, bytes, Purpose::Work)?, len);
        if !buffer.clear_mapped() {
            self.zero(&buffer.inner);
        }
        Ok(buffer)
    }
}

impl<T: Element> Buffer<T> {
    /// All elements.
    ///
    /// # Errors
    /// When the copy from device memory fails.
    pub fn read(&self) -> Result<Vec<T>, KernelError> {
        self.read_range(0..self.len())
    }

    /// Some elements.
    ///
    /// # Errors
    /// When the range leaves the buffer, or the copy from device memory fails.
    pub fn read_range(&self, range: Range<usize>) -> Result<Vec<T>, KernelError> {
        self.check_range("read", range.end)?;
        let mut out = vec![T::zeroed(); range.len()];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut out);
        let offset = self.byte_of(range.start);
        if let Some(source) = self.inner.mapped() {
            // SAFETY: `source` maps the whole buffer, the range was checked, submissions are waited
            // for before anything reads, and `out` is a fresh host allocation.
            unsafe { std::ptr::copy_nonoverlapping(source.add(offset), bytes.as_mut_ptr(), bytes.len()) };
        } else if !bytes.is_empty() {
            let staging = BufferInner::new(&self.inner.device, "read-back", bytes.len() as u64, Purpose::ReadBack)?;
            let staging = Arc::new(staging);
            let region = vk::BufferCopy { src_offset: offset as u64, dst_offset: 0, size: bytes.len() as u64 };
            copy_now(&self.inner, &staging, region)?;
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
        if data.len() != self.len() {
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
        self.write_bytes(self.byte_of(offset), bytemuck::cast_slice(data))
    }

    /// Zeros, the padding among them. The device writes them itself where the host cannot: a card's bus is the slower
    /// way, and staging as large as the buffer would count against the budget.
    fn clear(&self) -> Result<(), KernelError> {
        if self.clear_mapped() { Ok(()) } else { zero_now(&self.inner) }
    }

    /// The same, if the host can.
    fn clear_mapped(&self) -> bool {
        let Some(target) = self.inner.mapped() else { return false };
        let bytes = usize::try_from(self.inner.bytes).unwrap_or(usize::MAX);
        // SAFETY: `target` maps the whole buffer, which nothing has used yet.
        unsafe { std::ptr::write_bytes(target, 0, bytes) };
        true
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
            let region = vk::BufferCopy { src_offset: 0, dst_offset: offset as u64, size: bytes.len() as u64 };
            copy_now(&Arc::new(staging), &self.inner, region)?;
        }
        Ok(())
    }

    fn check_range(&self, what: &'static str, end: usize) -> Result<(), KernelError> {
        if end > self.len() { Err(self.range_error(what, end)) } else { Ok(()) }
    }

    fn range_error(&self, what: &'static str, end: usize) -> KernelError {
        KernelError::Shape {
            kernel: "host copy",
            buffer: what,
            got: format!("{end} elements"),
            expected: format!("{} elements in `{}`", self.len(), self.name()),
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
