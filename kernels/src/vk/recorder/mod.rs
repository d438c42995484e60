//! Passes in order, recorded for one submission or for many.

mod bound;
mod grid;
mod record;
mod recording;
mod section;
mod timings;

pub use bound::{Bindings, Bound};
pub use grid::Grid;
pub use record::Recorder;
pub(super) use record::{copy_now, zero_now};
pub use section::Section;
pub use timings::{PassTime, Timings, last_finished};
