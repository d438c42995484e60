//! An issue: one release of an asset, whose copies are told apart.

use super::chips::{ChipMap, OCTAVES};
use super::code::{Code, CopyKey, Position};
use super::coverage::shares;
use crate::base::digest::Digest;
use crate::base::numbers::narrow;
use crate::base::prf::Prf;
use crate::error::EngineError;
use crate::scene::Model;
use crate::scene::gaussians::{CHANNELS, SH_FLOATS, Y0};

/// The part of the way to black or white that a splat's offsets may take together as plain signs: beyond it one of the
/// two signs would be cut off.
const ROOM: f64 = 0.5;
/// What amplitudes may be multiplied by all the same: pure colours have a channel at an end, and the others still move.
const LEAST_ROOM: f64 = 0.5;

/// An asset and what its copies are stamped by.
#[derive(Debug)]
pub struct Issue<'a> {
    model: &'a Model,
    prf: Prf,
    original: Digest,
    chips: ChipMap,
    code: Code,
    held: Vec<Held>,
    strength: f64,
}

/// What holds the amplitudes of a splat.
#[derive(Clone, Copy, Debug)]
struct Held {
    /// Of what others are multiplied by.
    share: f64,
    /// What they may be multiplied by at most.
    room: f64,
}

/// Chips, and what decides each.
struct Coded {
    chips: ChipMap,
    code: Code,
}

impl<'a> Issue<'a> {
    /// The issue of `model`, whose secrets all follow from `prf`. `strength` multiplies the amplitudes of all octaves;
    /// [`strength_for`](super::fidelity::strength_for) finds one.
    #[must_use]
    pub fn new(model: &'a Model, prf: Prf, strength: f64) -> Self {
        let chips = ChipMap::new(&model.gaussians);
        let code = Code::draw(&prf, chips.num_chips());
        Self::with_code(model, prf, strength, Coded { chips, code })
    }

    /// What an owner writes into all that leaves the house, alike in every copy: "one of this issue" is all that it
    /// says.
    #[must_use]
    pub fn of_owner(model: &'a Model, prf: Prf, strength: f64) -> Self {
        let chips = ChipMap::new(&model.gaussians);
        let code = Code::of_owner(&prf, model.digest(), chips.num_chips());
        Self::with_code(model, prf, strength, Coded { chips, code })
    }

    fn with_code(model: &'a Model, prf: Prf, strength: f64, coded: Coded) -> Self {
        let Coded { chips, code } = coded;
        let rows = model.gaussians.sh_coeffs.chunks_exact(SH_FLOATS).zip(shares(model)).enumerate();
        // What nobody draws says nothing in any film.
        let room_of = |row, dc: &[f32]| if model.is_ever_drawn(row) { room(&dc[..CHANNELS]) } else { 0.0 };
        let held = rows.map(|(row, (dc, share))| Held { share, room: room_of(row, dc) }).collect();
        Self { model, prf, original: model.digest(), chips, code, held, strength }
    }

    /// The same issue at another strength.
    #[must_use]
    pub fn with_strength(self, strength: f64) -> Self {
        Self { strength, ..self }
    }

    /// An issue of the same asset at the same strength, by another key.
    #[must_use]
    pub fn by_another_key(&self, prf: Prf) -> Self {
        let code = Code::draw(&prf, self.chips.num_chips());
        let Self { model, original, ref chips, ref held, strength, .. } = *self;
        Self { model, prf, original, chips: chips.clone(), code, held: held.clone(), strength }
    }

    /// What the amplitudes of all octaves are multiplied by.
    #[must_use]
    pub fn strength(&self) -> f64 {
        self.strength
    }

    /// For each splat what its amplitudes are multiplied by.
    fn strengths(&self) -> impl Iterator<Item = f64> {
        self.held.iter().map(|held| held.room.min(held.share * self.strength))
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
    /// `Y0·Δ = min(share · strength, room) · Σ_octaves amplitude · g(x − μ)`, for the splat's chip x of each octave,
    /// see [`Code::offsets`].
    #[must_use]
    pub fn stamp(&self, copy: u64) -> Vec<f32> {
        self.stamp_onto(self.model.gaussians.sh_coeffs.clone(), copy)
    }

    /// The same, of coefficients that differ from the model's already.
    #[must_use]
    pub fn stamp_onto(&self, mut sh_coeffs: Vec<f32>, copy: u64) -> Vec<f32> {
        let offsets: Vec<f64> = self.code.offsets(&self.copy_key(copy)).collect();
        for (row, colour) in sh_coeffs.chunks_exact_mut(SH_FLOATS).zip(self.spread(&offsets)) {
            row[..CHANNELS].iter_mut().for_each(|dc| *dc = narrow(f64::from(*dc) + colour / Y0));
        }
        sh_coeffs
    }

    /// How far the colour of each splat moves where chips have these values: M·chips.
    #[must_use]
    pub fn spread(&self, values: &[f64]) -> Vec<f64> {
        let moved = |(chips, strength): (&[usize; OCTAVES.len()], f64)| {
            strength * chips.iter().zip(OCTAVES).map(|(chip, octave)| octave.amplitude * values[*chip]).sum::<f64>()
        };
        self.chips.of_splats().iter().zip(self.strengths()).map(moved).collect()
    }

    /// What is said of each chip where this is said of each splat: Mᵀ·splats.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless there is a number for each splat.
    pub fn collect(&self, splats: &[f64]) -> Result<Vec<f64>, EngineError> {
        self.gathered(splats, |moved| moved)
    }

    /// The same with squares of how far chips move colours: how much of a leak each chip is.
    ///
    /// # Errors
    /// As [`collect`](Self::collect).
    pub fn collect_squared(&self, splats: &[f64]) -> Result<Vec<f64>, EngineError> {
        self.gathered(splats, |moved| moved * moved)
    }

    /// Takes off estimated chips what the mean of all copies would leave in them (regression on μ = 2p − 1): copies
    /// that are mixed by a rule lean that way, and it tells none from the other.
    pub fn take_off_mean(&self, chips: &mut [f64], strength: &[f64], noise: f64) {
        let mean = |(position, strength): (&Position, &f64)| match position {
            Position::OfCopy(bias) => strength / (strength + noise) * (2.0 * bias.probability() - 1.0),
            Position::Shared(_) => 0.0,
        };
        let means: Vec<f64> = self.code.positions().iter().zip(strength).map(mean).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let length = dot(&means, &means);
        let share = if length > 0.0 { dot(chips, &means) / length } else { 0.0 };
        chips.iter_mut().zip(&means).for_each(|(chip, mean)| *chip -= share * mean);
    }

    fn gathered(&self, splats: &[f64], weight: fn(f64) -> f64) -> Result<Vec<f64>, EngineError> {
        if splats.len() != self.held.len() {
            return Err(EngineError::Usage {
                what: "evidence of a leak".to_owned(),
                got: format!("{} splats", splats.len()),
                expected: format!("{} splats", self.held.len()),
            });
        }
        let mut values = vec![0.0; self.chips.num_chips()];
        for ((chips, strength), splat) in self.chips.of_splats().iter().zip(self.strengths()).zip(splats) {
            for (chip, octave) in chips.iter().zip(OCTAVES) {
                values[*chip] += weight(strength * octave.amplitude) * splat;
            }
        }
        Ok(values)
    }
}

/// What the amplitudes of a splat with these DC terms may be multiplied by; a colour that is no number has no room.
fn room(dc: &[f32]) -> f64 {
    let all: f64 = OCTAVES.iter().map(|octave| octave.amplitude).sum();
    let to_the_end = |dc: &f32| {
        let colour = 0.5 + Y0 * f64::from(*dc);
        if colour.is_finite() { colour.min(1.0 - colour).max(0.0) } else { 0.0 }
    };
    let room = ROOM / all * dc.iter().map(to_the_end).fold(f64::INFINITY, f64::min);
    if dc.iter().all(|dc| dc.is_finite()) { room.max(LEAST_ROOM) } else { 0.0 }
}
