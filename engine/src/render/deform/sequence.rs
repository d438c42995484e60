//! Splats that a file gives for each moment.

use guard4d_kernels::Device;

use super::state::SplatState;
use crate::error::EngineError;
use crate::scene::Gaussians;
use crate::scene::motion::nearest_moment;

/// The moments of a scene. They lie in the host's memory; those that are asked for are uploaded.
#[derive(Debug)]
pub(super) struct Sequence {
    moments: Vec<Gaussians>,
}

impl Sequence {
    /// Takes the moments over, their colours changed by what tells those of `gaussians` from the first moment's.
    pub(super) fn new(gaussians: &Gaussians, moments: &[Gaussians]) -> Self {
        let mut moments = moments.to_vec();
        let Some(first) = moments.first().map(|first| first.sh_coeffs.clone()) else { return Self { moments } };
        let offsets: Vec<f32> = gaussians.sh_coeffs.iter().zip(first).map(|(new, old)| new - old).collect();
        if offsets.iter().any(|&offset| offset != 0.0) {
            for moment in &mut moments {
                moment.sh_coeffs.iter_mut().zip(&offsets).for_each(|(coeff, offset)| *coeff += offset);
            }
        }
        Self { moments }
    }

    /// The splats at `time`.
    pub(super) fn deform(&self, device: &Device, time: f32) -> Result<SplatState, EngineError> {
        SplatState::upload(device, &self.moments[nearest_moment(time, self.moments.len())])
    }
}
