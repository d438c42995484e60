//! What commands need of the program around them.

use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::Precision;
use guard4d_kernels::Device;
use indicatif::ProgressBar;

/// The program that commands run in: it knows the flags that all of its commands have.
pub trait Host {
    /// Opens the device that was asked for.
    ///
    /// # Errors
    /// When there is none such, or it fails.
    fn open(&self) -> Result<Device, EngineError>;

    /// How the matrices of CLIP's image tower are to be kept.
    fn precision(&self) -> Precision;

    /// Says something to whoever watches.
    fn note(&self, words: &str);

    /// Prints a result: as JSON if that was asked for, else its words.
    ///
    /// # Errors
    /// [`EngineError::Io`] when it cannot be written.
    fn print(&self, json: &serde_json::Value, words: &str) -> Result<(), EngineError>;

    /// A progress bar of so many steps.
    fn progress(&self, len: u64) -> ProgressBar;

    /// Makes an interruption a request from now on, instead of the end.
    fn listen(&self);

    /// Whether the work is to stop.
    fn is_stopped(&self) -> bool;
}
