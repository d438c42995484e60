//! Splats on paths on the device.

use guard4d_kernels::splat::trajectory::{self, PATH_FLOATS, Paths};
use guard4d_kernels::{Buffer, Device};

use super::state::SplatState;
use crate::error::EngineError;
use crate::scene::trajectories::Trajectories;

/// The paths of a scene, as the kernel reads them.
#[derive(Debug)]
pub(super) struct PathField {
    paths: Buffer<f32>,
}

impl PathField {
    pub(super) fn new(device: &Device, paths: &Trajectories) -> Result<Self, EngineError> {
        let mut rows = Vec::with_capacity(PATH_FLOATS * paths.centres.len());
        let splats = paths.motion.iter().zip(&paths.omega).zip(paths.centres.iter().zip(&paths.log_durations));
        for ((motion, omega), (centre, log_duration)) in splats {
            let [x1, y1, z1, x2, y2, z2, x3, y3, z3] = *motion;
            rows.extend([x1, y1, z1, *centre, x2, y2, z2, (-log_duration).exp(), x3, y3, z3, 0.0]);
            rows.extend(omega);
        }
        Ok(Self { paths: device.buffer_from("scene.paths", &rows)? })
    }

    /// The splats at `time`.
    pub(super) fn deform(&self, device: &Device, canonical: &SplatState, time: f32) -> Result<SplatState, EngineError> {
        let mut out = SplatState::like(device, canonical)?;
        let mut rec = device.recorder()?;
        let splats = Paths { means: &canonical.means, quats: &canonical.quats, paths: &self.paths };
        trajectory::forward(&mut rec, splats, time, &mut out.means, &mut out.quats)?;
        rec.copy(&canonical.scales, 0, &mut out.scales, 0, canonical.scales.len())?;
        rec.submit()?;
        Ok(out)
    }
}
