//! Distortions: what becomes of a clip on its way to whoever verifies it.

mod chain;
mod kind;
mod layer;
mod resizer;

pub use chain::DistortionChain;
pub use kind::{Distortion, DistortionKind};
pub(crate) use layer::brightness;
pub use layer::{DistortionLayer, Drawn};
pub(crate) use resizer::Resizer;
