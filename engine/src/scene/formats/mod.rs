//! Splat files of other tools; each module reads one container into [`Gaussians`](super::gaussians::Gaussians) and
//! writes new colours in place.

mod archive;
mod bytes;
mod format;
pub mod glb;
pub mod sog;
pub mod splat;
pub mod splatv;
pub mod spz;
pub(super) mod steps;
pub(super) mod values;

pub(super) use format::import;
pub use format::{Export, Format, KNOWN};
