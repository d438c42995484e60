//! Splats of one moment on the device.

use std::sync::{Arc, OnceLock};

use guard4d_kernels::splat::project::{Buckets, RawSplats};
use guard4d_kernels::{Buffer, Device};
use nalgebra::{Matrix3, Vector3};

use super::buckets::buckets_of;
use crate::error::EngineError;
use crate::scene::Gaussians;
use crate::scene::ellipsoid::of_covariance;

/// Splats before activation, as the projection reads them.
///
/// # Shapes
/// `means` \[N,4\] = x, y, z, opacity logit · `scales` \[N,4\] = log, 0 · `quats` \[N,4\] = w, x, y, z ·
/// `sh_coeffs` \[N,16,3\], shared between moments unless the network deforms them
#[derive(Debug)]
pub struct SplatState {
    pub(super) means: Buffer<f32>,
    pub(super) scales: Buffer<f32>,
    pub(super) quats: Buffer<f32>,
    pub(super) sh_coeffs: Arc<Buffer<f32>>,
    sh_degree: u32,
    /// Made when a renderer asks for them.
    buckets: OnceLock<Buckets>,
}

impl SplatState {
    /// The canonical splats.
    pub(super) fn upload(device: &Device, gaussians: &Gaussians) -> Result<Self, EngineError> {
        let n = gaussians.len();
        let (mut means, mut scales) = (Vec::with_capacity(4 * n), Vec::with_capacity(4 * n));
        for ((mean, scale), opacity) in gaussians.means.iter().zip(&gaussians.scales).zip(&gaussians.opacities) {
            means.extend([mean[0], mean[1], mean[2], *opacity]);
            scales.extend([scale[0], scale[1], scale[2], 0.0]);
        }
        Ok(Self {
            means: device.buffer_from("scene.means", &means)?,
            scales: device.buffer_from("scene.scales", &scales)?,
            quats: device.buffer_from("scene.quats", gaussians.quats.as_flattened())?,
            sh_coeffs: Arc::new(device.buffer_from("scene.sh_coeffs", &gaussians.sh_coeffs)?),
            sh_degree: gaussians.sh_degree,
            buckets: OnceLock::new(),
        })
    }

    /// Room for the splats of a moment that keeps the coefficients of `canonical`.
    pub(super) fn like(device: &Device, canonical: &Self) -> Result<Self, EngineError> {
        let floats = canonical.means.len();
        Ok(Self {
            means: device.buffer("moment.means", floats)?,
            scales: device.buffer("moment.scales", floats)?,
            quats: device.buffer("moment.quats", floats)?,
            sh_coeffs: Arc::clone(&canonical.sh_coeffs),
            sh_degree: canonical.sh_degree,
            buckets: OnceLock::new(),
        })
    }

    /// Number of splats.
    #[must_use]
    pub fn len(&self) -> usize {
        self.means.len() / 4
    }

    /// Whether there are no splats.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The splats, read back from the device. Ellipsoids of quaternions that kept their length come back as those of
    /// unit quaternions.
    ///
    /// # Errors
    /// When the device fails.
    pub fn read(&self) -> Result<Gaussians, EngineError> {
        let (means, scales, quats) = (self.means.read()?, self.scales.read()?, self.quats.read()?);
        let (means, scales, quats) = (means.as_chunks::<4>().0, scales.as_chunks::<4>().0, quats.as_chunks().0);
        let ellipsoid = |([x, y, z, keeps_norm], quat): (&[f32; 4], &[f32; 4])| match *keeps_norm {
            0.0 => ([*x, *y, *z], *quat),
            _ => of_unit_quaternion([*x, *y, *z], *quat),
        };
        let (scales, quats) = scales.iter().zip(quats).map(ellipsoid).unzip();
        Ok(Gaussians {
            means: means.iter().map(|[x, y, z, _]| [*x, *y, *z]).collect(),
            quats,
            scales,
            opacities: means.iter().map(|[.., logit]| *logit).collect(),
            sh_coeffs: self.sh_coeffs.read()?,
            sh_degree: self.sh_degree,
        })
    }

    /// Makes what renderers go by that sort by buckets.
    ///
    /// # Errors
    /// When device memory runs out or the device fails.
    pub(in crate::render) fn make_buckets(&self, device: &Device) -> Result<(), EngineError> {
        if self.buckets.get().is_none() {
            let first = |rows: Vec<f32>| -> Vec<[f32; 3]> {
                rows.as_chunks::<4>().0.iter().map(|[x, y, z, _]| [*x, *y, *z]).collect()
            };
            let (means, scales) = (first(self.means.read()?), first(self.scales.read()?));
            self.make_buckets_of(device, &means, &scales)?;
        }
        Ok(())
    }

    /// Makes the same of means and log scales as they were before they were stored as these.
    ///
    /// # Errors
    /// When device memory runs out.
    pub(super) fn make_buckets_of(
        &self,
        device: &Device,
        means: &[[f32; 3]],
        scales: &[[f32; 3]],
    ) -> Result<(), EngineError> {
        // Whoever came first made the same.
        let _ = self.buckets.set(buckets_of(device, means, scales)?);
        Ok(())
    }

    /// What the projection reads.
    #[must_use]
    pub fn raw(&self) -> RawSplats<'_> {
        RawSplats { means: &self.means, scales: &self.scales, quats: &self.quats, buckets: self.buckets.get() }
    }

    /// SH coefficients at this moment `[N,16,3]`.
    #[must_use]
    pub fn sh_coeffs(&self) -> &Arc<Buffer<f32>> {
        &self.sh_coeffs
    }

    /// Highest SH degree of the scene.
    #[must_use]
    pub fn sh_degree(&self) -> u32 {
        self.sh_degree
    }

    pub(super) fn geometry_bytes(&self) -> usize {
        size_of::<f32>() * (self.means.len() + self.scales.len() + self.quats.len())
    }
}

/// Log standard deviations and a unit quaternion of the ellipsoid that log standard deviations and the matrix of a
/// quaternion of any length make: its covariance has the axes as eigenvectors.
fn of_unit_quaternion(scales: [f32; 3], [w, x, y, z]: [f32; 4]) -> ([f32; 3], [f32; 4]) {
    let [w, x, y, z] = [w, x, y, z].map(f64::from);
    let matrix = Matrix3::new(
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    );
    let half = matrix * Matrix3::from_diagonal(&Vector3::from(scales.map(|s| f64::from(s).exp())));
    of_covariance(half * half.transpose())
}
