//! Sizes that cross the border between host and shader.
//!
//! Shape letters, used everywhere: `N` splats, `I` intersections, `H W` pixels, `F` frames,
//! `K` inner dimension or SH bases, `B T C` batch, tokens, channels, `L` message bits.

use crate::error::KernelError;
use crate::vk::Buffer;

/// A length as shaders take it.
///
/// # Panics
/// Never for lengths of buffers: a device binds less than 2³² elements.
#[must_use]
pub fn dim(n: usize) -> u32 {
    u32::try_from(n).expect("device buffers hold fewer than 2^32 elements")
}

/// A length as shaders take it where they compute with signed coordinates.
///
/// # Panics
/// Never for lengths of images: a device binds less than 2³¹ pixels.
#[must_use]
pub fn dim_signed(n: usize) -> i32 {
    i32::try_from(n).expect("clips hold fewer than 2^31 pixels")
}

/// Frames, height and width of a clip; the channel count is the op's own matter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClipShape {
    /// `F`
    pub frames: usize,
    /// `H` in pixels
    pub height: usize,
    /// `W` in pixels
    pub width: usize,
}

impl ClipShape {
    /// `F·H·W`
    #[must_use]
    pub fn pixels(self) -> usize {
        self.frames * self.height * self.width
    }
}

/// Whether a result replaces what its buffer held or joins it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Accumulate {
    /// `(=)`
    Overwrite,
    /// `(+=)`
    Add,
}

impl Accumulate {
    /// The shaders' `ACCUMULATE` constant.
    #[must_use]
    pub fn flag(self) -> u32 {
        u32::from(self == Self::Add)
    }
}

/// Channels of a colour coefficient.
const RGB: usize = 3;

/// Which SH coefficients of a splat have offsets, and so how a row of offsets is laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OffsetBases {
    /// The DC term alone: rows `[4]`, three channels and a zero.
    Dc,
    /// All coefficients up to the degree: rows `[16,3]` like the coefficients', zero above the degree.
    All,
}

impl OffsetBases {
    /// Coefficients that a row has room for.
    #[must_use]
    pub const fn count(self) -> usize {
        match self {
            Self::Dc => 1,
            Self::All => 16,
        }
    }

    /// Floats of a row, a whole number of texels.
    #[must_use]
    pub const fn floats(self) -> usize {
        (RGB * self.count()).next_multiple_of(4)
    }

    /// The shaders' `OFFSET_TEXELS` constant.
    #[must_use]
    pub(crate) fn texels(self) -> u32 {
        dim(self.floats() / 4)
    }
}

/// Checks one buffer's length.
///
/// # Errors
/// [`KernelError::Shape`] when it is not `expected`.
pub fn expect_len<T>(
    kernel: &'static str,
    name: &'static str,
    buffer: &Buffer<T>,
    expected: usize,
) -> Result<(), KernelError>
where
    T: crate::vk::Element,
{
    if buffer.len() == expected {
        return Ok(());
    }
    Err(KernelError::Shape {
        kernel,
        buffer: name,
        got: format!("[{}]", buffer.len()),
        expected: format!("[{expected}]"),
    })
}

/// Refuses a buffer that is too short.
pub(crate) fn require_len(
    kernel: &'static str,
    buffer: &'static str,
    got: usize,
    at_least: usize,
) -> Result<(), KernelError> {
    if got >= at_least {
        return Ok(());
    }
    Err(KernelError::Shape { kernel, buffer, got: format!("[{got}]"), expected: format!("[{at_least}] or more") })
}
