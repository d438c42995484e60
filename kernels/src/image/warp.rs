//! Affine warps of clips: rotation, crop, zoom.

use super::frames::{expect_frames, frames_grid};
use crate::error::KernelError;
use crate::registry::image::{warp_bwd, warp_fwd};
use crate::shape::{ClipShape, dim_signed};
use crate::vk::{Buffer, Recorder};

const KERNEL: &str = "image/warp";

/// How a warp reads between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// The nearest pixel; halves go to the next one.
    Nearest,
    /// Linear between the four around.
    Bilinear,
}

impl Sampling {
    fn flag(self) -> u32 {
        u32::from(self == Self::Bilinear)
    }
}

/// Where every output pixel reads its input, in pixels from the centre of the first one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp {
    /// Rows `[x from column, x from row, x]` and the same for y.
    pub map: [[f64; 3]; 2],
    /// How it reads between pixels.
    pub sampling: Sampling,
    /// Colour of what lies outside.
    pub fill: [f32; 3],
}

impl Warp {
    /// Turns the picture about its middle, counterclockwise as seen; what is left of the frame has the colour `fill`.
    #[must_use]
    pub fn rotation(clip: ClipShape, degrees: f64, sampling: Sampling, fill: [f32; 3]) -> Self {
        let (sin, cos) = degrees.to_radians().sin_cos();
        // Rows grow downwards.
        Self::about_the_middle(clip, [[cos, -sin], [sin, cos]], sampling, fill)
    }

    /// The middle part of the picture, `share` of each side, enlarged to the frame.
    #[must_use]
    pub fn crop(clip: ClipShape, share: f64) -> Self {
        Self::about_the_middle(clip, [[share, 0.0], [0.0, share]], Sampling::Bilinear, [0.0; 3])
    }

    /// Left and right swapped.
    #[must_use]
    pub fn mirror(clip: ClipShape) -> Self {
        Self::about_the_middle(clip, [[-1.0, 0.0], [0.0, 1.0]], Sampling::Nearest, [0.0; 3])
    }

    /// The linear map `m` of positions as seen from the middle of the frame.
    #[must_use]
    pub fn about_the_middle(clip: ClipShape, m: [[f64; 2]; 2], sampling: Sampling, fill: [f32; 3]) -> Self {
        let middle = [clip.width, clip.height].map(|n| (n as f64 - 1.0) / 2.0);
        let row = |i: usize| [m[i][0], m[i][1], middle[i] - m[i][0] * middle[0] - m[i][1] * middle[1]];
        Self { map: [row(0), row(1)], sampling, fill }
    }

    /// Reads what `first` makes of a picture: both in one, with the sampling and the fill of this one.
    #[must_use]
    pub fn of(self, first: &Self) -> Self {
        let row = |[x, y, constant]: [f64; 3]| {
            let [xs, ys] = self.map;
            let through = |i: usize| x * xs[i] + y * ys[i];
            [through(0), through(1), through(2) + constant]
        };
        Self { map: first.map.map(row), ..self }
    }

    /// From input positions to output positions.
    fn inverse(&self) -> Result<[[f64; 3]; 2], KernelError> {
        let [[a, b, x0], [c, d, y0]] = self.map;
        let determinant = a * d - b * c;
        let inverse = [[d, -b, b * y0 - d * x0], [-c, a, c * x0 - a * y0]].map(|row| row.map(|v| v / determinant));
        if inverse.iter().flatten().all(|v| v.is_finite()) {
            return Ok(inverse);
        }
        let (got, expected) = (format!("{:?}", self.map), "a map that can be inverted".to_owned());
        Err(KernelError::Shape { kernel: KERNEL, buffer: "map", got, expected })
    }
}

/// Warps every frame.
///
/// # Shapes
/// in `x` \[F,H,W,4\] · out `y` likewise (=), fourth channel 0
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    clip: ClipShape,
    warp: &Warp,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_frames(KERNEL, clip, [("x", x), ("y", y)])?;
    warp.inverse()?;
    let [[xx, xy, x0], [yx, yy, y0]] = single(warp.map);
    let [fill_r, fill_g, fill_b] = warp.fill;
    let [frames, height, width] = [clip.frames, clip.height, clip.width].map(dim_signed);
    let params = warp_fwd::Params { frames, height, width, xx, xy, x0, yx, yy, y0, fill_r, fill_g, fill_b };
    let grid = frames_grid(clip.height * clip.width, clip.frames, warp_fwd::KERNEL.local_size[0]);
    rec.dispatch_spec(warp_fwd::Bind { x, y }, params, warp_fwd::Spec { bilinear: warp.sampling.flag() }, grid)
}

/// Gradient to the input: the exact adjoint of [`forward`], whose fill has none.
///
/// # Shapes
/// in `v_y` \[F,H,W,4\] · out `v_x` likewise (=), fourth channel 0
/// # Determinism: bitwise; gathered, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    clip: ClipShape,
    warp: &Warp,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    /// More than rounding can move a position by.
    const SLACK: f64 = 1e-3;
    expect_frames(KERNEL, clip, [("v_y", v_y), ("v_x", v_x)])?;
    let inverse = warp.inverse()?;
    // An input pixel is read from less than `radius` away along both axes.
    let radius = if warp.sampling == Sampling::Bilinear { 1.0 } else { 0.5 };
    #[allow(clippy::cast_possible_truncation, reason = "positions within a frame")]
    let reach = inverse.map(|[x, y, _]| (radius * (x.abs() + y.abs()) + SLACK) as f32);
    let [[xx, xy, x0], [yx, yy, y0]] = single(warp.map);
    let [[inverse_xx, inverse_xy, inverse_x0], [inverse_yx, inverse_yy, inverse_y0]] = single(inverse);
    let [frames, height, width] = [clip.frames, clip.height, clip.width].map(dim_signed);
    let params = warp_bwd::Params {
        frames,
        height,
        width,
        xx,
        xy,
        x0,
        yx,
        yy,
        y0,
        inverse_xx,
        inverse_xy,
        inverse_x0,
        inverse_yx,
        inverse_yy,
        inverse_y0,
        reach_x: reach[0],
        reach_y: reach[1],
    };
    let grid = frames_grid(clip.height * clip.width, clip.frames, warp_bwd::KERNEL.local_size[0]);
    rec.dispatch_spec(warp_bwd::Bind { v_y, v_x }, params, warp_bwd::Spec { bilinear: warp.sampling.flag() }, grid)
}

#[allow(clippy::cast_possible_truncation, reason = "positions within a frame")]
fn single(map: [[f64; 3]; 2]) -> [[f32; 3]; 2] {
    map.map(|row| row.map(|v| v as f32))
}
