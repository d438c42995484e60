//! Pictures: what is done to them on their way, undoing it, and how far apart two of them are.

pub mod colour_difference;
pub mod distortion;
pub mod foreground;
pub mod known_cameras;
pub mod known_views;
pub mod metrics;
pub mod part;
pub mod settle;
pub mod undo_guess;
