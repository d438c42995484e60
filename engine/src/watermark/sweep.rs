//! A mark at other strengths than its own: where the extractor begins to read it, and what that costs.
//!
//! An extractor that holds the message reads it from a mark of no strength at all.

use serde::Serialize;

use super::embed::Subject;
use super::evaluate::{HeldOut, leak, read_clips};
use super::extractor::{ExtractorWeights, Reader};
use super::metrics::PsnrSummary;
use super::null_panel::Leak;
use crate::error::EngineError;
use crate::scene::CameraSet;

/// Strengths to try, as shares of the mark's own.
pub const FACTORS: [f32; 8] = [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0];

/// What one strength is worth.
#[derive(Clone, Debug, Serialize)]
pub struct StrengthPoint {
    /// Share of the mark's own strength.
    pub factor: f32,
    /// Whole-frame fidelity of 8-bit frames; without a mark that of rounding alone.
    pub psnr: PsnrSummary,
    /// Message bits.
    pub bits: u32,
    /// Message bits read in each clip.
    pub matches: Vec<u32>,
    /// All of them together, against what chance gives.
    pub leak: Leak,
}

impl StrengthPoint {
    /// Share of the message's bits, mean over clips.
    #[must_use]
    pub fn accuracy(&self) -> f64 {
        self.leak.share()
    }
}

/// The coefficients `clean + strength × (marked − clean)`; where nothing is marked the bits stay what they are.
#[must_use]
pub fn at_strength(clean: &[f32], marked: &[f32], strength: f32) -> Vec<f32> {
    clean.iter().zip(marked).map(|(c, m)| if c == m { *m } else { c + strength * (m - c) }).collect()
}

/// Films the subject's model with the mark of `marked_sh` at each of `factors`, and reads it.
///
/// # Shapes
/// in `marked_sh` [N,16,3], the marked coefficients · out one point per factor, one reading per camera view
///
/// # Errors
/// [`EngineError::Usage`] for a factor that is negative or no number, coefficients of another model, or no camera; when
/// the device fails.
pub fn sweep(
    subject: &Subject<'_>,
    extractor: &ExtractorWeights,
    marked_sh: &[f32],
    factors: &[f32],
    cameras: &CameraSet,
) -> Result<Vec<StrengthPoint>, EngineError> {
    let clean = &subject.model.gaussians.sh_coeffs;
    let usage =
        |what: &str, got: String, expected: String| Err(EngineError::Usage { what: what.to_owned(), got, expected });
    if marked_sh.len() != clean.len() {
        let expected = format!("{}, as many as the model has", clean.len());
        return usage("marked coefficients", marked_sh.len().to_string(), expected);
    }
    if let Some(wrong) = factors.iter().find(|k| !(k.is_finite() && **k >= 0.0)) {
        return usage("strength", wrong.to_string(), "a number of 0 or more".to_owned());
    }
    let mut reader = Reader::new(subject.device, subject.clip, subject.key, extractor)?;
    let mut points = Vec::with_capacity(factors.len());
    for &factor in factors {
        let sh = at_strength(clean, marked_sh, factor);
        let film = HeldOut::shoot(subject.device, subject.model, &sh, cameras)?;
        let readings = read_clips(&mut reader, &film.marked, subject.key.bits())?;
        points.push(StrengthPoint {
            factor,
            psnr: film.psnr()?,
            bits: subject.message.num_bits(),
            matches: readings.iter().map(|r| r.matches(subject.message)).collect::<Result<_, _>>()?,
            leak: leak(&readings, subject.message)?,
        });
    }
    Ok(points)
}
