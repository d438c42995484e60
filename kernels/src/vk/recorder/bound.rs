//! What the passes of a recorder touch.

use std::sync::Arc;

use ash::vk;

use crate::vk::buffer::{Buffer, BufferInner, Element, Place};
use crate::vk::pipeline::KernelDef;

/// One buffer of a dispatch.
#[derive(Clone)]
pub struct Bound {
    pub(super) buffer: Arc<BufferInner>,
    pub(super) place: Place,
    pub(super) format: vk::Format,
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
