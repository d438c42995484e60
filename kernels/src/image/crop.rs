//! Windows of a clip as a convolution takes them: normalised, and with the pixels of a stride stacked.

use super::frames::CHANNELS;
use super::normalize::Normalization;
use super::resize::ImageSize;
use crate::error::KernelError;
use crate::registry::image::{crop_bwd, crop_fwd};
use crate::shape::{dim, dim_signed, require_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "image/crop";

/// What is cut out of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First frame.
    pub frame: usize,
    /// Frames.
    pub frames: usize,
    /// First row and first column.
    pub corner: [usize; 2],
    /// Height and width.
    pub size: ImageSize,
    /// Height and width of the clip's frames.
    pub full: ImageSize,
}

/// How its pixels are laid out: cell (Y, X) holds `patch`² pixels from (Y·patch, X·patch) of the padded window on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cells {
    /// Cells along the height and the width.
    pub grid: [usize; 2],
    /// Side of a cell in pixels.
    pub patch: usize,
    /// Zeros above and to the left of the window, in pixels.
    pub padding: usize,
}

impl Cells {
    /// Floats of a cell: those of its pixels, rounded up to a multiple of 8 with zeros, as a product can write them.
    #[must_use]
    pub fn channels(&self) -> usize {
        (self.patch * self.patch * CHANNELS).next_multiple_of(2 * CHANNELS)
    }

    /// Floats of `frames` frames of cells.
    #[must_use]
    pub fn len(&self, frames: usize) -> usize {
        frames * self.grid[0] * self.grid[1] * self.channels()
    }
}

/// A window and how its pixels are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// What is cut out.
    pub window: Window,
    /// How it is laid out.
    pub cells: Cells,
}

/// Which way a pass goes, and so what its buffers are called.
#[derive(Clone, Copy)]
enum Direction {
    Forward,
    Backward,
}

impl Direction {
    /// Names of the clip and of the cells.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Forward => ("x", "y"),
            Self::Backward => ("v_x", "v_y"),
        }
    }
}

impl Crop {
    fn check(&self, kind: Direction, clip: &Buffer<f32>, cells: &Buffer<f32>, first: usize) -> Result<(), KernelError> {
        let Window { frame, frames, corner, size, full } = self.window;
        if corner[0] + size.height > full.height || corner[1] + size.width > full.width {
            return Err(KernelError::Shape {
                kernel: KERNEL,
                buffer: "window",
                got: format!("{size:?} from {corner:?} on"),
                expected: format!("within {full:?}"),
            });
        }
        let (clip_name, cells_name) = kind.names();
        require_len(KERNEL, clip_name, clip.len(), (frame + frames) * full.height * full.width * CHANNELS)?;
        require_len(KERNEL, cells_name, cells.len(), self.cells.len(first + frames))
    }
}

/// Cuts a window out of a clip.
///
/// # Shapes
/// in `x` \[F, H, W, 4\] · out `y` \[., grid, grid, channels\], the frames from `y_frame` on (=)
/// # Equation: (x − mean) / std of the window's colours; 0 for the padding, beyond the window and in fourth channels
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    crop: &Crop,
    by: &Normalization,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
    y_frame: usize,
) -> Result<(), KernelError> {
    crop.check(Direction::Forward, x, y, y_frame)?;
    let Crop { window, cells } = crop;
    let ([mean_r, mean_g, mean_b], [std_r, std_g, std_b]) = (by.mean, by.std);
    let total = cells.len(window.frames) / CHANNELS;
    let params = crop_fwd::Params {
        total: dim(total),
        y_texel: dim(cells.len(y_frame) / CHANNELS),
        frame: dim_signed(window.frame),
        top: dim_signed(window.corner[0]),
        left: dim_signed(window.corner[1]),
        height: dim_signed(window.size.height),
        width: dim_signed(window.size.width),
        full_height: dim_signed(window.full.height),
        full_width: dim_signed(window.full.width),
        grid_height: dim_signed(cells.grid[0]),
        grid_width: dim_signed(cells.grid[1]),
        texels: dim_signed(cells.channels() / CHANNELS),
        padding: dim_signed(cells.padding),
        mean_r,
        mean_g,
        mean_b,
        std_r,
        std_g,
        std_b,
    };
    let spec = crop_fwd::Spec { patch: dim_signed(cells.patch) };
    rec.dispatch_spec(crop_fwd::Bind { x, y }, params, spec, Grid::threads(total))
}

/// Gradient to the clip, which joins what is there.
///
/// # Shapes
/// in `v_y` \[frames, grid, grid, channels\] or longer · out `v_x` \[F, H, W, 4\] (+=) inside the window, fourth
/// channel 0 there
/// # Determinism: bitwise; cells do not overlap, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    crop: &Crop,
    by: &Normalization,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    crop.check(Direction::Backward, v_x, v_y, 0)?;
    let Crop { window, cells } = crop;
    let [std_r, std_g, std_b] = by.std;
    let total = window.frames * window.size.height * window.size.width;
    let params = crop_bwd::Params {
        total: dim(total),
        frame: dim_signed(window.frame),
        top: dim_signed(window.corner[0]),
        left: dim_signed(window.corner[1]),
        height: dim_signed(window.size.height),
        width: dim_signed(window.size.width),
        full_height: dim_signed(window.full.height),
        full_width: dim_signed(window.full.width),
        grid_height: dim_signed(cells.grid[0]),
        grid_width: dim_signed(cells.grid[1]),
        texels: dim_signed(cells.channels() / CHANNELS),
        padding: dim_signed(cells.padding),
        std_r,
        std_g,
        std_b,
    };
    let spec = crop_bwd::Spec { patch: dim_signed(cells.patch) };
    let before = v_x.alias();
    rec.dispatch_spec(crop_bwd::Bind { v_y, v_before: &before, v_x }, params, spec, Grid::threads(total))
}
