//! Random splats before a camera, on the host, on the device and projected by the twin.

use guard4d_kernels::reference::Real;
use guard4d_kernels::reference::splat::project::{self as twin, Projected};
use guard4d_kernels::splat::project::{RawSplats, View};
use guard4d_kernels::{Buffer, Device};

use crate::support::random::Random;

/// Means with opacity logits, log scales, quaternions, each `[N,4]`.
pub(crate) struct Scene {
    pub(crate) means: Vec<f32>,
    pub(crate) scales: Vec<f32>,
    pub(crate) quats: Vec<f32>,
}

/// A camera at (0, 0, -3) that looks along z, slightly turned.
pub(crate) fn view(width: u32, height: u32) -> View {
    let (sin, cos) = 0.1f32.sin_cos();
    View {
        world_to_camera: [[cos, 0.0, sin, 0.05], [0.0, 1.0, 0.0, -0.1], [-sin, 0.0, cos, 3.0]],
        focal: [1.1 * width as f32, 1.2 * width as f32],
        centre: [0.5 * width as f32 - 0.5, 0.5 * height as f32 - 0.5],
        width,
        height,
    }
}

/// `n` splats in the unit cube, of a few pixels each in an image of 40 px or more.
pub(crate) fn random(n: usize, seed: u64) -> Scene {
    let mut random = Random(seed);
    let mut scene = Scene { means: Vec::new(), scales: Vec::new(), quats: Vec::new() };
    for _ in 0..n {
        let opacity = random.uniform(-3.0, 4.0);
        scene.means.extend(random.vec_f32(3, -1.0, 1.0));
        scene.means.push(opacity as f32);
        scene.scales.extend(random.vec_f32(3, -4.5, -2.0));
        scene.scales.push(0.0);
        scene.quats.extend(random.vec_f32(4, -1.0, 1.0));
    }
    scene
}

/// A [`Scene`] on the device.
pub(crate) struct Uploaded {
    means: Buffer<f32>,
    scales: Buffer<f32>,
    quats: Buffer<f32>,
}

impl Uploaded {
    pub(crate) fn raw(&self) -> RawSplats<'_> {
        RawSplats { means: &self.means, scales: &self.scales, quats: &self.quats }
    }
}

impl Scene {
    pub(crate) fn len(&self) -> usize {
        self.means.len() / 4
    }

    pub(crate) fn upload(&self, device: &Device) -> Uploaded {
        let buffer = |name: &str, data: &[f32]| device.buffer_from(name, data).expect("buffer");
        Uploaded {
            means: buffer("means", &self.means),
            scales: buffer("scales", &self.scales),
            quats: buffer("quats", &self.quats),
        }
    }

    /// The twin's projection.
    pub(crate) fn project<R: Real>(&self, view: &View) -> Vec<Option<Projected<R>>> {
        let convert = |data: &[f32]| data.iter().map(|v| R::of(f64::from(*v))).collect::<Vec<_>>();
        let of = |v: f32| R::of(f64::from(v));
        let view = twin::View {
            world_to_camera: view.world_to_camera.map(|row| row.map(of)),
            focal: view.focal.map(of),
            centre: view.centre.map(of),
            size: [view.width as usize, view.height as usize],
        };
        twin::forward(&view, &convert(&self.means), &convert(&self.scales), &convert(&self.quats))
    }
}
