//! Whether an embedding is as good as its owner asked for.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::evaluate::Evaluation;
use crate::error::EngineError;
use crate::evidence::statistics::match_p_value;
use crate::evidence::thresholds::Thresholds;
use crate::scene::camera::classes::CameraClass;
use crate::watermark::embed::Aim;

/// A mean of fractions may lie this much below its true value.
const ROUNDING: f64 = 1e-9;
/// Share of clips that must each be proof enough: a clip that leaks should be, more often than not.
const MIN_PROVEN: f64 = 0.5;

/// Least quality on held-out 8-bit frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Gate {
    /// Least share of marked clips that each prove the message alone.
    pub min_proven: f64,
    /// False-positive rate of that proof.
    pub fpr: f64,
    /// Least share of bits right on marked clips; none asks for nothing.
    pub min_accuracy: Option<f64>,
    /// Least share of bits right in films of some classes of cameras.
    pub min_class_accuracy: BTreeMap<CameraClass, f64>,
    /// Least whole-frame PSNR, mean over views, in dB; none asks for nothing.
    pub min_psnr_db: Option<f64>,
}

/// A figure that a gate looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// Share of marked clips that each prove the message alone.
    Proven,
    /// Share of bits right on marked clips.
    BitAccuracy,
    /// Share of bits right in films of a class of cameras.
    ClassAccuracy(CameraClass),
    /// Whole-frame PSNR, mean over views, in dB.
    Psnr,
}

/// A figure that fell short.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shortfall {
    /// Which.
    pub field: Figure,
    /// What was measured.
    pub got: f64,
    /// The least that was asked for.
    pub expected: f64,
}

impl Gate {
    /// The gate that asks for what `verify` needs: that half of the clips, each alone, say "present" by the decision
    /// rule of this message length. Messages too short to reach its rate are asked for all their bits.
    #[must_use]
    pub fn for_bits(bits: usize) -> Self {
        Self::after_search(bits, 1)
    }

    /// The same for a message that `verify` will choose from `searched`, as it does for ids.
    #[must_use]
    pub fn after_search(bits: usize, searched: u32) -> Self {
        let length = u32::try_from(bits).unwrap_or(u32::MAX);
        let fpr = (Thresholds::for_bits(bits).fpr / f64::from(searched)).max(match_p_value(length, length));
        Self { min_proven: MIN_PROVEN, fpr, min_accuracy: None, min_class_accuracy: BTreeMap::new(), min_psnr_db: None }
    }

    /// What training that ends in time aims at: what the gate asks for, of half of the clips that it lets fail besides,
    /// because the clips that training looks at are few.
    #[must_use]
    pub fn aim(&self) -> Aim {
        let proven = if self.min_proven > 0.0 { 0.5 + 0.5 * self.min_proven } else { 0.0 };
        Aim { p_value: self.fpr, proven, accuracy: self.min_accuracy.unwrap_or(0.0) }
    }

    /// Refuses bounds that no result can be compared with.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the bound.
    pub fn validate(&self) -> Result<(), EngineError> {
        let usage = |what: &str, got: f64, expected: &str| {
            Err(EngineError::Usage { what: what.to_owned(), got: got.to_string(), expected: expected.to_owned() })
        };
        let shares = [
            ("least share of clips that prove", self.min_proven),
            ("least bit accuracy", self.min_accuracy.unwrap_or(0.0)),
        ];
        let in_class = self.min_class_accuracy.values().map(|share| ("least bit accuracy of a class", *share));
        for (what, share) in shares.into_iter().chain(in_class) {
            if !(0.0..=1.0).contains(&share) {
                return usage(what, share, "a share from 0 to 1");
            }
        }
        match self.min_psnr_db {
            Some(db) if !db.is_finite() => usage("least PSNR", db, "a number of dB"),
            _ => Ok(()),
        }
    }

    /// The figures that fall short; none when the gate is met. A figure that is no number falls short.
    #[must_use]
    pub fn missed(&self, evaluation: &Evaluation) -> Vec<Shortfall> {
        let proven = (Figure::Proven, evaluation.proven(self.fpr), Some(self.min_proven));
        let accuracy = (Figure::BitAccuracy, evaluation.marked, self.min_accuracy);
        let psnr = (Figure::Psnr, evaluation.psnr.mean_of_views_db.0, self.min_psnr_db);
        // What was not measured falls short.
        let measured =
            |class: &CameraClass| evaluation.classes.get(class).map_or(f64::NAN, |figure| figure.bit_accuracy);
        let of_class =
            |(class, share): (&CameraClass, &f64)| (Figure::ClassAccuracy(*class), measured(class), Some(*share));
        let classes = self.min_class_accuracy.iter().map(of_class);
        let short = |(field, got, bound): (Figure, f64, Option<f64>)| {
            let expected = bound?;
            let is_met = got + ROUNDING >= expected;
            (!is_met).then_some(Shortfall { field, got, expected })
        };
        [proven, accuracy].into_iter().chain(classes).chain([psnr]).filter_map(short).collect()
    }
}

impl fmt::Display for Shortfall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, got, expected } = *self;
        let percent = |figure: f64| format!("{:.1} %", 100.0 * figure);
        match field {
            Figure::Proven => {
                let (got, expected) = (percent(got), percent(expected));
                write!(f, "marked clips that prove the message alone: {got}, expected at least {expected}")
            }
            Figure::BitAccuracy => {
                write!(f, "bits right on marked clips: {}, expected at least {}", percent(got), percent(expected))
            }
            Figure::ClassAccuracy(class) => {
                let (got, expected) = (percent(got), percent(expected));
                write!(f, "bits right in films of the class `{class}`: {got}, expected at least {expected}")
            }
            Figure::Psnr => write!(f, "PSNR of whole frames: {got:.2} dB, expected at least {expected:.2} dB"),
        }
    }
}
