//! What is done to pictures, and how far apart two of them are.

mod colour_difference;
mod distortion;
mod foreground;
mod known_cameras;
mod known_views;
mod metrics;
mod part;
mod undo_guess;
