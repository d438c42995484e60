//! Features of canonical positions at one time, from six planes per level.

use crate::error::KernelError;
use crate::registry::splat::hexplane_fwd;
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Device, Grid, Recorder};

const KERNEL: &str = "splat/hexplane";

/// Planes per level, for the pairs xy, xz, xt, yz, yt, zt of coordinates.
pub const PLANES: usize = 6;

/// One plane as stored: `[C, R_b, R_a]`, the first coordinate of the pair along the rows.
#[derive(Clone, Copy, Debug)]
pub struct Plane<'a> {
    /// Values, channel-major.
    pub data: &'a [f32],
    /// Samples along the first coordinate.
    pub width: usize,
    /// Samples along the second coordinate.
    pub height: usize,
}

/// All planes on the device, channels minor and padded with zeros to whole texels.
#[derive(Debug)]
pub struct Planes {
    texels: Buffer<f32>,
    shapes: Buffer<u32>,
    aabb: [[f32; 3]; 2],
    levels: usize,
    channel_texels: usize,
}

impl Planes {
    /// Uploads `planes` (six per level) of `channels` channels; `aabb` in the order it is stored.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when a plane has not `channels * height * width` values, or their number
    /// is no multiple of six; when memory runs out.
    pub fn new(
        device: &Device,
        planes: &[Plane<'_>],
        channels: usize,
        aabb: [[f32; 3]; 2],
    ) -> Result<Self, KernelError> {
        let padded = channels.next_multiple_of(4);
        let (mut texels, mut shapes) = (Vec::new(), Vec::new());
        for plane in planes {
            let samples = plane.width * plane.height;
            if plane.data.len() != samples * channels || samples == 0 {
                return Err(shape_error(plane.data.len(), format!("[{channels},{},{}]", plane.height, plane.width)));
            }
            shapes.extend([dim(texels.len() / 4), dim(plane.width), dim(plane.height), 0]);
            for sample in 0..samples {
                let value = |c: usize| if c < channels { plane.data[c * samples + sample] } else { 0.0 };
                texels.extend((0..padded).map(value));
            }
        }
        if planes.is_empty() || !planes.len().is_multiple_of(PLANES) || channels == 0 {
            return Err(shape_error(planes.len(), "six planes per level".to_owned()));
        }
        Ok(Self {
            texels: device.buffer_from("hexplane.planes", &texels)?,
            shapes: device.buffer_from("hexplane.plane_shapes", &shapes)?,
            aabb,
            levels: planes.len() / PLANES,
            channel_texels: padded / 4,
        })
    }

    /// Floats of one feature row: levels times padded channels.
    #[must_use]
    pub fn features(&self) -> usize {
        4 * self.levels * self.channel_texels
    }
}

fn shape_error(got: usize, expected: String) -> KernelError {
    KernelError::Shape { kernel: KERNEL, buffer: "planes", got: format!("[{got}]"), expected }
}

/// Features of the first `n` means.
///
/// # Shapes
/// in `means` \[N,4\] · out `features` \[N, levels * padded channels\] (=), padding channels 0
/// # Equation
/// Cao & Johnson 2023 as in 4DGaussians: positions go through `(p - aabb_0) 2/(aabb_1 - aabb_0) - 1`,
/// the time is taken as it is; bilinear, corners aligned, border outside; product over the six planes.
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    planes: &Planes,
    means: &Buffer<f32>,
    time: f32,
    features: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let n = means.len() / 4;
    require_len(KERNEL, "features", features.len(), n * planes.features())?;
    let [first, second] = planes.aabb;
    let params = hexplane_fwd::Params {
        n: dim(n),
        levels: dim(planes.levels),
        channel_texels: dim(planes.channel_texels),
        time,
        first_x: first[0],
        first_y: first[1],
        first_z: first[2],
        second_x: second[0],
        second_y: second[1],
        second_z: second[2],
    };
    let bind = hexplane_fwd::Bind { means, planes: &planes.texels, plane_shapes: &planes.shapes, features };
    rec.dispatch(bind, params, Grid::threads(n))
}
