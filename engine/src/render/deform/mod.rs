//! Splats at a moment in time.

mod buckets;
mod field;
mod latest;
mod mixed;
mod network;
mod paths;
mod sequence;
mod state;
mod warp;

pub use field::DeformField;
pub use mixed::MixedField;
pub use network::HiddenRows;
pub use state::SplatState;
