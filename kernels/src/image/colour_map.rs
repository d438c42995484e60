//! A linear map of colours.

use super::frames::CHANNELS;
use crate::error::KernelError;
use crate::registry::image::colour_map_apply;
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "image/colour_map";

/// Rows are the colours going out, columns the ones coming in.
pub type ColourMap = [[f32; 3]; 3];

/// Maps every colour of a clip.
///
/// # Shapes
/// in `x` \[n,4\], fourth channel ignored · out `y` \[n,4\] (=), fourth channel 0
/// # Equation: M x
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, map: &ColourMap, x: &Buffer<f32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    expect_len(KERNEL, "y", y, x.len())?;
    let n = x.len() / CHANNELS;
    let [[rr, rg, rb], [gr, gg, gb], [br, bg, bb]] = *map;
    let params = colour_map_apply::Params { n: dim(n), rr, rg, rb, gr, gg, gb, br, bg, bb };
    rec.dispatch(colour_map_apply::Bind { x, y }, params, Grid::threads(n))
}

/// Gradient to the input.
///
/// # Shapes
/// in `v_y` \[n,4\], fourth channel ignored · out `v_x` \[n,4\] (=), fourth channel 0
/// # Equation: Mᵀ v_y
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    map: &ColourMap,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    forward(rec, &transposed(map), v_y, v_x)
}

pub(super) fn transposed(map: &ColourMap) -> ColourMap {
    std::array::from_fn(|i| std::array::from_fn(|j| map[j][i]))
}
