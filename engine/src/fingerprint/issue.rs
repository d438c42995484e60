//! An issue: one release of an asset, whose copies are told apart.

use super::chips::{ChipMap, OCTAVES};
use super::code::{Code, CopyKey, Position};
use super::film::SplatEvidence;
use crate::base::digest::Digest;
use crate::base::numbers::narrow;
use crate::base::prf::Prf;
use crate::error::EngineError;
use crate::scene::Model;
use crate::scene::gaussians::{CHANNELS, SH_FLOATS, Y0};

/// The part of the way to black or white that a splat's offsets may take together as plain signs: beyond it one of the
/// two signs would be cut off.
const ROOM: f64 = 0.5;

/// An asset and what its copies are stamped by.
#[derive(Debug)]
pub struct Issue<'a> {
    model: &'a Model,
    prf: Prf,
    original: Digest,
    chips: ChipMap,
    code: Code,
    /// For each splat what its amplitudes may be multiplied by at most.
    room: Vec<f64>,
    strength: f64,
}

impl<'a> Issue<'a> {
    /// The issue of `model`, whose secrets all follow from `prf`. `strength` multiplies the amplitudes of all octaves;
    /// [`strength_for`](super::fidelity::strength_for) finds one.
    #[must_use]
    pub fn new(model: &'a Model, prf: Prf, strength: f64) -> Self {
        let chips = ChipMap::new(&model.gaussians);
        let code = Code::draw(&prf, chips.num_chips());
        let room = model.gaussians.sh_coeffs.chunks_exact(SH_FLOATS).map(|row| room(&row[..CHANNELS])).collect();
        Self { model, prf, original: model.digest(), chips, code, room, strength }
    }

    /// The same issue at another strength.
    #[must_use]
    pub fn with_strength(self, strength: f64) -> Self {
        Self { strength, ..self }
    }

    /// For each splat what its amplitudes are multiplied by.
    fn strengths(&self) -> impl Iterator<Item = f64> {
        self.room.iter().map(|room| room.min(self.strength))
    }

    /// The unstamped asset.
    #[must_use]
    pub fn model(&self) -> &'a Model {
        self.model
    }

    /// The code of its copies.
    #[must_use]
    pub fn code(&self) -> &Code {
        &self.code
    }

    /// The secret of copy number `copy`.
    #[must_use]
    pub fn copy_key(&self, copy: u64) -> CopyKey {
        CopyKey::new(&self.prf, self.original, copy)
    }

    /// The coefficients of copy number `copy`, laid out as those of [`Gaussians`](crate::scene::Gaussians): all three
    /// channels of the DC terms are moved by the same, and nothing else is.
    ///
    /// # Equation
    /// `Y0·Δ = strength · Σ_octaves amplitude · g(x − μ)`, for the splat's chip x of each octave, see
    /// [`Code::offsets`].
    #[must_use]
    pub fn stamp(&self, copy: u64) -> Vec<f32> {
        let offsets: Vec<f64> = self.code.offsets(&self.copy_key(copy)).collect();
        let mut sh_coeffs = self.model.gaussians.sh_coeffs.clone();
        let splats = self.chips.of_splats().iter().zip(self.strengths());
        for (row, (chips, strength)) in sh_coeffs.chunks_exact_mut(SH_FLOATS).zip(splats) {
            let colour: f64 = chips.iter().zip(OCTAVES).map(|(chip, octave)| octave.amplitude * offsets[*chip]).sum();
            let moved = strength * colour / Y0;
            row[..CHANNELS].iter_mut().for_each(|dc| *dc = narrow(f64::from(*dc) + moved));
        }
        sh_coeffs
    }

    /// What a film says of each chip: its splats' evidence, weighed by how far the chip moves them, less what the mean
    /// of all copies would say (regression on μ = 2p − 1). Nothing here knows a copy's chips.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless there is evidence of each splat.
    pub fn evidence(&self, splats: &SplatEvidence) -> Result<Vec<f64>, EngineError> {
        let count = self.room.len();
        if [splats.residual.len(), splats.response.len()] != [count; 2] {
            return Err(EngineError::Usage {
                what: "evidence of a film".to_owned(),
                got: format!("{} splats", splats.residual.len()),
                expected: format!("{count} splats"),
            });
        }
        let (mut evidence, mut response) = (vec![0.0; self.chips.num_chips()], vec![0.0; self.chips.num_chips()]);
        for (splat, (chips, strength)) in self.chips.of_splats().iter().zip(self.strengths()).enumerate() {
            for (chip, octave) in chips.iter().zip(OCTAVES) {
                let moved = strength * octave.amplitude;
                evidence[*chip] += moved * splats.residual[splat];
                response[*chip] += moved * moved * splats.response[splat];
            }
        }
        let mean = |(position, response): (&Position, &f64)| match position {
            Position::OfCopy(bias) => response * (2.0 * bias.probability() - 1.0),
            Position::Shared(_) => 0.0,
        };
        let expected: Vec<f64> = self.code.positions().iter().zip(&response).map(mean).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let length = dot(&expected, &expected);
        let share = if length > 0.0 { dot(&evidence, &expected) / length } else { 0.0 };
        evidence.iter_mut().zip(&expected).for_each(|(c, mean)| *c -= share * mean);
        Ok(evidence)
    }
}

/// What the amplitudes of a splat with these DC terms may be multiplied by; a colour that is no number has no room.
fn room(dc: &[f32]) -> f64 {
    let all: f64 = OCTAVES.iter().map(|octave| octave.amplitude).sum();
    let to_the_end = |dc: &f32| {
        let colour = 0.5 + Y0 * f64::from(*dc);
        if colour.is_finite() { colour.min(1.0 - colour).max(0.0) } else { 0.0 }
    };
    ROOM / all * dc.iter().map(to_the_end).fold(f64::INFINITY, f64::min)
}
