//! What is seen of a leak, be it a film or an asset, as the estimate of its chips needs it.

use crate::error::EngineError;

/// What a leak says of each splat of the original.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatEvidence {
    /// Sum over samples of the limited difference times the splat's weight there: Aᵀ W r.
    pub residual: Vec<f64>,
    /// The same of a difference of 1 everywhere that counts: how much of the leak the splat is.
    pub response: Vec<f64>,
    /// Samples that count: pixels of films, splats of assets.
    pub samples: u64,
    /// Sum of the squares of their differences.
    pub squares: f64,
}

impl SplatEvidence {
    /// Of `splats` that nothing is said of.
    #[must_use]
    pub fn none(splats: usize) -> Self {
        Self { residual: vec![0.0; splats], response: vec![0.0; splats], samples: 0, squares: 0.0 }
    }
}

/// A leak that can be asked how it would look if colours were others.
pub trait Seen {
    /// What it says.
    fn evidence(&self) -> &SplatEvidence;

    /// How many samples have errors that go together.
    fn together(&self) -> f64;

    /// What it would say if each splat's colour differed by this: Aᵀ W A of the colours.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    fn normal(&mut self, colours: &[f64]) -> Result<Vec<f64>, EngineError>;
}
