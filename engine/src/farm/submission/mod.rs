//! What a scheduler is asked to run: files for Slurm, OpenJD, OpenCue, Flamenco and Deadline.

mod deadline;
mod flamenco;
mod opencue;
mod openjd;
mod slurm;
mod task;

pub use deadline::DeadlineFiles;
pub use opencue::CueNames;
pub use task::Submission;
