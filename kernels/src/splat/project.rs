//! Projection to the image plane.

use super::rules::{Extent, Opacity, Rules, SortKey};
use crate::error::KernelError;
use crate::registry::splat::project_fwd;
use crate::scan::radix_sort::SortPairs;
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Device, Grid, Recorder};

const KERNEL: &str = "splat/project";

/// A pinhole camera, `OpenCV` axes (x right, y down, z forward), and how it shows splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// World to camera, row-major, the last row (0, 0, 0, 1) left out.
    pub world_to_camera: [[f32; 4]; 3],
    /// Focal lengths in px.
    pub focal: [f32; 2],
    /// Principal point in px, pixel centres at whole numbers: (W-1)/2, (H-1)/2 when symmetric.
    pub centre: [f32; 2],
    /// Image width in px.
    pub width: u32,
    /// Image height in px.
    pub height: u32,
    /// How splats are drawn.
    pub rules: Rules,
}

/// What rules go by beside depth that sort by buckets of it.
#[derive(Debug)]
pub struct Buckets {
    /// Splats in the order that those of one bucket have, front to back `[N]`.
    pub along: Buffer<u32>,
    /// Lower and upper corner of the box that the scene is in, world units.
    pub corners: [[f32; 3]; 2],
}

/// Splats before activation.
#[derive(Clone, Copy, Debug)]
pub struct RawSplats<'a> {
    /// Position and opacity logit `[N,4]`.
    pub means: &'a Buffer<f32>,
    /// Logarithms of the standard deviations `[N,4]`; where the fourth is not 0, the rotation matrix is that of the
    /// quaternion as it is, without making it a unit.
    pub scales: &'a Buffer<f32>,
    /// Rotations w, x, y, z of any norm `[N,4]`.
    pub quats: &'a Buffer<f32>,
    /// What rules go by that sort by buckets.
    pub buckets: Option<&'a Buckets>,
}

/// Projected splats, in the order of the input.
#[derive(Debug)]
pub struct Projection {
    /// Centre, scaled conic, opacity, depth, exponent of base 2 that still counts `[N,8]`; zeros when culled.
    pub geom: Buffer<f32>,
    /// Unit vector from the camera to the mean `[N,4]`.
    pub dirs: Buffer<f32>,
    /// Tiles of 8 x 8 px that can see the splat `[N,4]`: x0, y0, x1, y1; empty when culled.
    pub tile_rects: Buffer<u32>,
    /// Bits of the view depth, or of the distance, as keys, the splats as values `[N]`.
    pub order: SortPairs,
}

impl Projection {
    /// Room for `n` splats.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, n: usize) -> Result<Self, KernelError> {
        Ok(Self {
            geom: device.buffer("projection.geom", 8 * n)?,
            dirs: device.buffer("projection.dirs", 4 * n)?,
            tile_rects: device.buffer("projection.tile_rects", 4 * n)?,
            order: SortPairs::new(device, "projection.order", n)?,
        })
    }

    /// Bytes of device memory.
    #[must_use]
    pub fn bytes(&self) -> usize {
        4 * (self.geom.len() + self.dirs.len() + self.tile_rects.len()) + self.order.bytes()
    }
}

/// Projects every splat and culls those that no pixel can see.
///
/// # Shapes
/// in `splats` \[N,4\] each · out `out` (=), depths not yet sorted
/// # Equation
/// EWA splatting, Zwicker et al. 2001; near plane as in Kerbl et al. 2023, the rest by the rules of the view (those of
/// Kerbl et al. 2023 stand in the shader as constants too). A splat is culled when its projection is not finite, when
/// its opacity never reaches the alpha threshold, when the rules do not draw it, or when it reaches no tile.
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    view: &View,
    splats: RawSplats<'_>,
    n: usize,
    out: &mut Projection,
) -> Result<(), KernelError> {
    for (name, len) in [
        ("means", splats.means.len()),
        ("scales", splats.scales.len()),
        ("quats", splats.quats.len()),
        ("dirs", out.dirs.len()),
        ("tile_rects", out.tile_rects.len()),
        ("geom", out.geom.len() / 2),
        ("order", 4 * out.order.capacity()),
    ] {
        require_len(KERNEL, name, len, 4 * n)?;
    }
    let bind = project_fwd::Bind {
        means: splats.means,
        scales: splats.scales,
        quats: splats.quats,
        geom: &mut out.geom,
        dirs: &mut out.dirs,
        tile_rects: &mut out.tile_rects,
        depth_keys: &mut out.order.keys,
        order: &mut out.order.values,
    };
    let spec = project_fwd::Spec { plain: view.rules.plain() };
    rec.dispatch_spec(bind, params(view, n), spec, Grid::threads(n))
}

fn params(view: &View, n: usize) -> project_fwd::Params {
    let [row_x, row_y, row_z] = view.world_to_camera;
    let rules = view.rules;
    project_fwd::Params {
        n: dim(n),
        width: view.width,
        height: view.height,
        fx: view.focal[0],
        fy: view.focal[1],
        cx: view.centre[0],
        cy: view.centre[1],
        view_00: row_x[0],
        view_01: row_x[1],
        view_02: row_x[2],
        view_03: row_x[3],
        view_10: row_y[0],
        view_11: row_y[1],
        view_12: row_y[2],
        view_13: row_y[3],
        view_20: row_z[0],
        view_21: row_z[1],
        view_22: row_z[2],
        view_23: row_z[3],
        dilation: rules.dilation,
        split: rules.min_split,
        min_minor: rules.min_minor,
        min_major: rules.min_major,
        margin: rules.margin,
        guard: rules.guard,
        min_alpha: rules.min_alpha,
        span: rules.span(),
        compensated: u32::from(rules.opacity == Opacity::Compensated),
        tiles: u32::from(rules.extent == Extent::Tiles),
        distance: u32::from(rules.sort_key == SortKey::Distance),
    }
}
