//! Ctrl-C, SIGTERM and SIGXCPU: long commands look between two pieces of work whether to stop.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};

use guard4d_engine::error::EngineError;

use super::report::say;
use crate::flags::common::Common;

static REQUESTED: AtomicBool = AtomicBool::new(false);
/// Set by SIGXCPU, with which schedulers say that the time is nearly up.
static IS_OUT_OF_TIME: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);
/// Whether somebody listens already.
static IS_HEARD: AtomicBool = AtomicBool::new(false);

/// From now on a signal is a request instead of the end.
pub(crate) fn listen(common: &Common) {
    if IS_HEARD.swap(true, Ordering::SeqCst) {
        return;
    }
    let quiet = common.quiet;
    let handler = move || {
        if !REQUESTED.swap(true, Ordering::SeqCst) && !quiet {
            say("stopping after the work at hand");
        }
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        // Without it a signal ends the program at once, as it does other programs.
        tracing::warn!("signals: {error}");
    }
    #[cfg(unix)]
    if let Err(error) = signal_hook::flag::register(signal_hook::consts::SIGXCPU, Arc::clone(&IS_OUT_OF_TIME)) {
        tracing::warn!("SIGXCPU: {error}");
    }
}

/// Whether a signal came.
pub(crate) fn is_requested() -> bool {
    REQUESTED.load(Ordering::SeqCst) || IS_OUT_OF_TIME.load(Ordering::SeqCst)
}

/// An error when a signal came, for work that has nothing to save.
pub(crate) fn check() -> Result<(), EngineError> {
    if is_requested() { Err(EngineError::Stopped) } else { Ok(()) }
}
