//! The splats of a scene at any moment, most of them mixed of two beside it.

use std::sync::Arc;

use guard4d_kernels::nn::axpy;
use guard4d_kernels::{Buffer, Device, Recorder};

use super::field::DeformField;
use super::latest::Latest;
use super::state::SplatState;
use crate::base::numbers::narrow;
use crate::error::EngineError;

/// Steps from the first moment to the last at which a scene that moves is looked for, or a few more.
const STEPS: u32 = 48;
/// Parts of the motion that are mixed between, for each of them at least: with two, what is wrong is a quarter of what
/// it is with one.
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
    /// Even parts of the motion that are mixed between; none where moments cost next to nothing, or a file says which
    /// there are.
    parts: Option<u32>,
    /// What tells one moment from the next, of one of a splat's properties at a time: one buffer for each length.
    deltas: Vec<Buffer<f32>>,
    /// Mixed moments.
    cached: Latest,
}

impl MixedField {
    /// Takes over a scene.
    #[must_use]
    pub fn new(device: &Device, field: DeformField) -> Self {
        // All bends of the movement are ends of parts: between two of them splats move all but evenly.
        let parts = field.bends().map(|bends| bends * (PARTS * STEPS).div_ceil(bends));
        let field = field.with_cached_bytes(LEAST, MOST_BYTES);
        Self { device: device.clone(), field, parts, deltas: Vec::new(), cached: Latest::default() }
    }

    /// Even steps from the first moment to the last, some dozens: at as many moments a scene that moves is looked for.
    /// Those at their ends are the cheapest.
    #[must_use]
    pub fn steps(&self) -> u32 {
        self.parts.map_or(STEPS, |parts| parts / (parts / STEPS))
    }

    /// The splats at `time`, which is from 0 to 1: means, log scales, quaternions and what else changes are mixed
    /// linearly of the two moments beside it.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn at(&mut self, time: f64) -> Result<Arc<SplatState>, EngineError> {
        let Some(parts) = self.parts.map(f64::from) else { return self.field.at(narrow(time)) };
        let at = time.clamp(0.0, 1.0) * parts;
        if at.fract() == 0.0 {
            return self.field.at(narrow(at / parts));
        }
        if let Some(mixed) = self.cached.take_up(at) {
            return Ok(mixed);
        }
        let mut beside = |part: f64| self.field.at(narrow(part / parts));
        let (before, behind) = (beside(at.floor())?, beside(at.ceil())?);
        let mixed = Arc::new(self.mix(&before, &behind, narrow(at.fract()))?);
        if self.cached.len() == CACHED {
            self.cached.drop_first();
        }
        self.cached.push(at, &mixed);
        Ok(mixed)
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
        let known = self.deltas.iter().position(|delta| delta.len() == before.len());
        let at = known.unwrap_or(self.deltas.len());
        if known.is_none() {
            self.deltas.push(self.device.buffer("moment.delta", before.len())?);
        }
        let delta = &mut self.deltas[at];
        axpy::forward(rec, -1.0, behind, before, delta)?;
        axpy::forward(rec, share, before, delta, out)?;
        Ok(())
    }
}
