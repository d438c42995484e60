//! Optimisers, and what is done to gradients before them.

pub mod adam;
pub mod neighbour_mean;
