//! How a scene moves.

use super::deformation::DeformationWeights;
use super::gaussians::Gaussians;
use super::trajectories::Trajectories;
use super::warp::WarpWeights;

/// What turns the splats of a scene into those of a moment, at a time from 0 to 1.
#[derive(Clone, Debug, Default)]
pub enum Motion {
    /// Nothing: the scene always looks the same.
    #[default]
    Still,
    /// A `HexPlane` network (4DGaussians).
    HexPlane(Box<DeformationWeights>),
    /// A network that changes splats after activation (Deformable-3DGS).
    Warp(Box<WarpWeights>),
    /// A path for each splat (`SpacetimeGaussians`).
    Paths(Trajectories),
    /// Splats for each moment, as many each time, the first moment's being the scene's own; the nearest one is shown.
    /// Colours differ from the scene's by an offset that all moments have in common.
    Sequence(Vec<Gaussians>),
}

impl Motion {
    /// Whether the scene always looks the same.
    #[must_use]
    pub const fn is_still(&self) -> bool {
        matches!(self, Self::Still)
    }

    /// Whether a network moves the scene, as networks are trained on scenes of D-NeRF's kind.
    #[must_use]
    pub const fn is_network(&self) -> bool {
        matches!(self, Self::HexPlane(_) | Self::Warp(_))
    }

    /// The `HexPlane` network of a scene that has one.
    #[must_use]
    pub fn network(&self) -> Option<&DeformationWeights> {
        match self {
            Self::HexPlane(weights) => Some(weights),
            _ => None,
        }
    }
}

/// The moment of `count` that is shown at `time`, 0 to 1: the nearest one.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "moments are few, and times outside 0 to 1 are the ends"
)]
#[must_use]
pub fn nearest_moment(time: f32, count: usize) -> usize {
    let last = count.saturating_sub(1);
    ((time.clamp(0.0, 1.0) * last as f32).round() as usize).min(last)
}
