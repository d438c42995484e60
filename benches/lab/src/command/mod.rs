//! `guard4d lab`: the commands of the lab, their flags, and what they need of the program around them.

mod chips;
mod dump;
mod host;
mod isa;
mod locating;
mod pretrain;
mod root;
mod study;
mod tracing;

pub use host::Host;
pub use root::{LabArgs, run};
