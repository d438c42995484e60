//! A renderer at settings that are not its own, and those at which a film was drawn.

use std::fmt::{self, Display};

use serde::{Deserialize, Serialize};

use super::profile::{Profile, Viewer};
use crate::base::numbers::narrow;

/// Widths that are tried, in px of the image: square roots of dilations.
const WIDTHS: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0];
/// Times that the width is looked for between the three best.
const CLOSER: u32 = 2;

/// A renderer at its own settings or others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Whose renderer.
    pub viewer: Viewer,
    /// What it adds to both variances of a splat on the image, px², where that is not what it usually adds. A film
    /// that was made smaller has less, whoever drew it.
    pub dilation: Option<f32>,
    /// Highest degree of the spherical harmonics that it draws, where that is not its usual one.
    pub sh_degree: Option<u32>,
}

impl From<Viewer> for Settings {
    fn from(viewer: Viewer) -> Self {
        Self { viewer, dilation: None, sh_degree: None }
    }
}

impl Settings {
    /// What it does to splats.
    #[must_use]
    pub fn profile(&self) -> Profile {
        let mut profile = self.viewer.profile();
        profile.rules.dilation = self.dilation.unwrap_or(profile.rules.dilation);
        profile.storage.sh_degree = self.sh_degree.unwrap_or(profile.storage.sh_degree);
        profile
    }

    /// Whether what is uploaded is the same at both, so that a renderer may go from one to the other.
    #[must_use]
    pub fn keeps_splats_of(&self, other: &Self) -> bool {
        let [own, other] = [self.profile(), other.profile()];
        own.storage == other.storage && own.rules.sort_key == other.rules.sort_key
    }

    /// Those of the same renderer at which pictures of an asset with harmonics up to `sh_degree` cost least, if that is
    /// less than `clearly` times `own_cost`, what they cost at these, and these else.
    ///
    /// # Errors
    /// Those of `cost`.
    pub fn fitted<E>(
        self,
        sh_degree: u32,
        clearly: f64,
        own_cost: f64,
        cost: &mut impl FnMut(Self) -> Result<f64, E>,
    ) -> Result<Self, E> {
        let (mut best, mut least) = (self, own_cost);
        for degree in 0..sh_degree.min(self.profile().storage.sh_degree) {
            let lower = Self { sh_degree: Some(degree), ..self };
            let costs = cost(lower)?;
            if costs < clearly * least {
                (best, least) = (lower, costs);
            }
        }
        let own = best;
        let as_wide = |width: f64| Self { dilation: Some(narrow(width * width)), ..own };
        let mut tried = Vec::new();
        for width in WIDTHS {
            tried.push((width, cost(as_wide(width))?));
        }
        for _ in 0..CLOSER {
            let width = closer(&tried);
            tried.push((width, cost(as_wide(width))?));
            tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        let (width, costs) = tried.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0.0, f64::INFINITY));
        Ok(if costs < clearly * least { as_wide(width) } else { own })
    }
}

/// Where a parabola through the best of some points, in order, and the two beside it is lowest; in the middle of the
/// wider side where it has just been.
fn closer(tried: &[(f64, f64)]) -> f64 {
    let best = (0..tried.len()).min_by(|a, b| tried[*a].1.total_cmp(&tried[*b].1)).unwrap_or(0);
    let at = best.clamp(1, tried.len() - 2);
    let [(left, a), (middle, b), (right, c)] = [tried[at - 1], tried[at], tried[at + 1]];
    let (before, behind) = ((middle - left) * (b - c), (middle - right) * (b - a));
    let lowest = middle - 0.5 * ((middle - left) * before - (middle - right) * behind) / (before - behind);
    let lowest = if lowest.is_finite() { lowest.clamp(left, right) } else { middle };
    if [left, middle, right].iter().all(|known| (known - lowest).abs() > 0.01 * (right - left)) {
        return lowest;
    }
    let is_before = if best == at { middle - left > right - middle } else { best < at };
    if is_before { 0.5 * (left + middle) } else { 0.5 * (middle + right) }
}

impl Display for Settings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.viewer.name())?;
        if let Some(dilation) = self.dilation {
            write!(f, ", dilation {dilation:.2} px²")?;
        }
        match self.sh_degree {
            Some(degree) => write!(f, ", harmonics to degree {degree}"),
            None => Ok(()),
        }
    }
}
