//! What a loss compares, and where it leaves what it finds.

use crate::error::KernelError;
use crate::image::CHANNELS;
use crate::shape::{Accumulate, expect_len, require_len};
use crate::vk::Buffer;

/// Where a loss leaves its value, and how its gradient enters the sum.
#[derive(Debug)]
pub struct Term<'a> {
    /// Values of all losses of a step; read once when they are wanted.
    pub values: &'a mut Buffer<f32>,
    /// Element of `values` that this loss overwrites with its unweighted value; the first, if it has several.
    pub slot: usize,
    /// Factor on the gradient.
    pub weight: f32,
    /// Whether the gradient replaces its buffer's content or joins it.
    pub accumulate: Accumulate,
}

impl Term<'_> {
    /// Refuses a buffer without room for `count` values from the slot on.
    pub(super) fn slots(&self, kernel: &'static str, count: usize) -> Result<(), KernelError> {
        require_len(kernel, "values", self.values.len(), self.slot + count)
    }
}

/// Two runs of pixels that are compared.
#[derive(Clone, Copy, Debug)]
pub struct PixelPair<'a> {
    /// Image or clip that gets the gradient.
    pub image: &'a Buffer<f32>,
    /// First pixel of it.
    pub image_px: usize,
    /// What it is compared with.
    pub reference: &'a Buffer<f32>,
    /// First pixel of it.
    pub reference_px: usize,
    /// Pixels compared.
    pub num_px: usize,
}

impl PixelPair<'_> {
    pub(super) fn check(&self, kernel: &'static str, v_image: Option<&Buffer<f32>>) -> Result<(), KernelError> {
        v_image.map_or(Ok(()), |v_image| expect_len(kernel, "v_image", v_image, self.image.len()))?;
        for (name, buffer, first) in
            [("image", self.image, self.image_px), ("reference", self.reference, self.reference_px)]
        {
            let end = (first + self.num_px) * CHANNELS;
            if buffer.len() < end {
                return Err(KernelError::Shape {
                    kernel,
                    buffer: name,
                    got: format!("[{}]", buffer.len()),
                    expected: format!("at least [{end}]"),
                });
            }
        }
        Ok(())
    }
}
