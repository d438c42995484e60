//! The splats of a scene at any moment, those between even steps mixed of the two beside them.

use std::sync::Arc;

use guard4d_kernels::nn::axpy;
use guard4d_kernels::{Buffer, Device, Recorder};

use super::field::DeformField;
use super::state::SplatState;
use crate::base::numbers::narrow;
use crate::error::EngineError;

/// Steps from the first moment to the last, or as few more as have each bend of the movement at an end; a movement that
/// bends more often is not mixed.
const STEPS: u32 = 48;
const MOST_BENDS: u32 = 96;
/// Parts of a step that are mixed between: what is wrong with that is a quarter with halves.
const PARTS: u32 = 2;
/// What moments that are asked for may take in all, beside the latest few; and mixed moments that are kept.
const MOST_BYTES: usize = 512 << 20;
const LEAST: usize = 8;
const CACHED: usize = 4;

/// A scene on the device. A network takes several times as long for a moment as a picture of it does, so it is asked at
/// even moments alone, which are kept.
#[derive(Debug)]
pub struct MixedField {
    device: Device,
    field: DeformField,
    steps: u32,
    /// Whether moments between steps are mixed; else they cost next to nothing, or a file says which there are.
    mixes: bool,
    /// What tells one step from the other, of one part at a time.
    delta: Option<Buffer<f32>>,
    /// Mixed moments, the least recently used first.
    cached: Vec<(u64, Arc<SplatState>)>,
}

impl MixedField {
    /// Takes over a scene.
    #[must_use]
    pub fn new(device: &Device, field: DeformField) -> Self {
        // Between two bends splats move all but evenly.
        let bends = field.bends().filter(|bends| *bends <= MOST_BENDS);
        let steps = bends.map_or(STEPS, |bends| bends * STEPS.div_ceil(bends));
        let field = field.with_cached_bytes(LEAST, MOST_BYTES);
        Self { device: device.clone(), field, steps, mixes: bends.is_some(), delta: None, cached: Vec::new() }
    }

    /// Steps from the first moment to the last.
    #[must_use]
    pub fn steps(&self) -> u32 {
        self.steps
    }

    /// The splats at the step that is nearest to `time`, which is from 0 to 1.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn nearest(&mut self, time: f64) -> Result<Arc<SplatState>, EngineError> {
        self.part(f64::from(PARTS) * (time * f64::from(self.steps)).round())
    }

    /// The splats at `time`, which is from 0 to 1: means, log scales, quaternions and what else changes are mixed
    /// linearly of the two moments beside it.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn at(&mut self, time: f64) -> Result<Arc<SplatState>, EngineError> {
        if !self.mixes {
            return self.field.at(narrow(time));
        }
        let at = time.clamp(0.0, 1.0) * f64::from(PARTS * self.steps);
        if at.fract() == 0.0 {
            return self.part(at);
        }
        let key = at.to_bits();
        if let Some(found) = self.cached.iter().position(|(known, _)| *known == key) {
            self.cached[found..].rotate_left(1);
        } else {
            let (before, behind) = (self.part(at.floor())?, self.part(at.ceil())?);
            let mixed = Arc::new(self.mix(&before, &behind, narrow(at.fract()))?);
            if self.cached.len() == CACHED {
                self.cached.remove(0);
            }
            self.cached.push((key, mixed));
        }
        Ok(Arc::clone(&self.cached[self.cached.len() - 1].1))
    }

    fn part(&mut self, number: f64) -> Result<Arc<SplatState>, EngineError> {
        self.field.at(narrow(number / f64::from(PARTS * self.steps)))
    }

    fn mix(&mut self, before: &SplatState, behind: &SplatState, share: f32) -> Result<SplatState, EngineError> {
        let mut out = SplatState::like(&self.device, before)?;
        let mut rec = self.device.recorder()?;
        for (before, behind, out) in [
            (&before.means, &behind.means, &mut out.means),
            (&before.scales, &behind.scales, &mut out.scales),
            (&before.quats, &behind.quats, &mut out.quats),
        ] {
            self.mix_part(&mut rec, [before, behind], share, out)?;
        }
        if !Arc::ptr_eq(&before.sh_coeffs, &behind.sh_coeffs) {
            let mut sh = self.device.buffer("moment.sh_coeffs", before.sh_coeffs.len())?;
            self.mix_part(&mut rec, [&before.sh_coeffs, &behind.sh_coeffs], share, &mut sh)?;
            out.sh_coeffs = Arc::new(sh);
        }
        rec.submit()?;
        Ok(out)
    }

    fn mix_part(
        &mut self,
        rec: &mut Recorder,
        [before, behind]: [&Buffer<f32>; 2],
        share: f32,
        out: &mut Buffer<f32>,
    ) -> Result<(), EngineError> {
        let mut delta = match self.delta.take() {
            Some(delta) if delta.len() == before.len() => delta,
            _ => self.device.buffer("moment.delta", before.len())?,
        };
        axpy::forward(rec, -1.0, behind, before, &mut delta)?;
        axpy::forward(rec, share, before, &delta, out)?;
        self.delta = Some(delta);
        Ok(())
    }
}
