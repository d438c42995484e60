//! LPIPS against the reference implementation, and its gradient against differences.

mod distance;
mod pass;
mod weights;
