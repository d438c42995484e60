//! What kernels over frames have in common: pixels, grids, lengths.

use crate::error::KernelError;
use crate::shape::{ClipShape, dim, expect_len};
use crate::vk::{Buffer, Grid};

/// Floats of a pixel.
pub const CHANNELS: usize = 4;

/// Planes along one grid axis; every device allows 65,535.
const PLANES_PER_AXIS: usize = 32_768;

/// Push constants of a kernel over a clip with two colour maps, `a_xx` to `a_zz` and `b_xx` to `b_zz`, row by row.
macro_rules! two_maps {
    ($kernel:ident, $clip:expr, $a:expr, $b:expr) => {{
        let [[a_xx, a_xy, a_xz], [a_yx, a_yy, a_yz], [a_zx, a_zy, a_zz]] = $a;
        let [[b_xx, b_xy, b_xz], [b_yx, b_yy, b_yz], [b_zx, b_zy, b_zz]] = $b;
        let [frames, height, width] = [$clip.frames, $clip.height, $clip.width].map(crate::shape::dim_signed);
        $kernel::Params {
            frames,
            height,
            width,
            a_xx,
            a_xy,
            a_xz,
            a_yx,
            a_yy,
            a_yz,
            a_zx,
            a_zy,
            a_zz,
            b_xx,
            b_xy,
            b_xz,
            b_yx,
            b_yy,
            b_yz,
            b_zx,
            b_zy,
            b_zz,
        }
    }};
}
pub(super) use two_maps;

/// Groups of `local` invocations for `items` of each plane along x, planes along y and, where they are many, z.
pub(super) fn frames_grid(items: usize, planes: usize, local: u32) -> Grid {
    let groups = items.div_ceil(local as usize);
    Grid::Groups([groups, planes.min(PLANES_PER_AXIS), planes.div_ceil(PLANES_PER_AXIS)].map(dim))
}

/// Refuses buffers that are not clips `[F,H,W,4]`.
pub(super) fn expect_frames(
    kernel: &'static str,
    clip: ClipShape,
    buffers: [(&'static str, &Buffer<f32>); 2],
) -> Result<(), KernelError> {
    buffers.into_iter().try_for_each(|(name, buffer)| expect_len(kernel, name, buffer, clip.pixels() * CHANNELS))
}
