//! The sub-studies: each is a list of arms and a report, and all of them stand in one table.

mod ablation;
mod attacks;
mod extractors;
mod fit;
mod methods;
mod pareto;
mod pretrained;
mod stability;
mod substudy;

pub use substudy::{SUBSTUDIES, Substudy};
