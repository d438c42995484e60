//! Twin of the rules by which renderers differ.

use crate::reference::real::Real;

/// How splats are projected and blended. `None` is "without".
#[derive(Clone, Copy, Debug)]
pub struct Rules<R> {
    /// Added to both variances, px².
    pub dilation: R,
    /// Whether opacity falls as the dilation makes the area grow.
    pub compensated: bool,
    /// Least half difference of the variances along the axes, px².
    pub min_split: R,
    /// Least variance along the shorter axis, px².
    pub min_minor: R,
    /// Variance along the longer axis below which a splat is not drawn, px².
    pub min_major: R,
    /// Half images within which directions shape a splat.
    pub margin: Option<R>,
    /// Half images within which a centre has to be.
    pub guard: Option<R>,
    /// Whether only 16 x 16 tiles that meet the 3-sigma square are reached.
    pub in_tiles: bool,
    /// Standard deviations at which falloff ends.
    pub reach: Option<R>,
    /// What falloff loses before it is made 1 in the middle again.
    pub foot: R,
    /// Least alpha that counts.
    pub min_alpha: R,
    /// Largest alpha.
    pub max_alpha: R,
    /// Whether a pixel ends behind the splat that leaves it too little, not before it.
    pub ends_behind: bool,
    /// Whether splats are sorted by their distance, not by their depth.
    pub by_distance: bool,
}

impl<R: Real> Rules<R> {
    /// Those of Kerbl et al. 2023.
    #[must_use]
    pub fn reference() -> Self {
        let zero = R::of(0.0);
        Self {
            dilation: R::of(0.3),
            compensated: false,
            min_split: zero,
            min_minor: zero,
            min_major: zero,
            margin: Some(R::of(1.3)),
            guard: None,
            in_tiles: true,
            reach: None,
            foot: zero,
            min_alpha: R::of(1.0 / 255.0),
            max_alpha: R::of(0.99),
            ends_behind: false,
            by_distance: false,
        }
    }
}
