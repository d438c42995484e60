//! What is done to pictures, and how far apart two of them are.

mod colour_difference;
mod distortion;
mod metrics;
mod undo_guess;
