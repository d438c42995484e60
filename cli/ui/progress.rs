//! The progress bar of long commands; silent when nobody watches.

use guard4d_engine::base::observer::{Observer, Progress};
use guard4d_engine::error::EngineError;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::stop;
use crate::flags::common::Common;

/// A bar of `len` steps with a message behind it.
pub(crate) fn bar(common: &Common, len: u64) -> ProgressBar {
    let target = if common.quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed_precise} ETA {eta} {wide_msg}");
    ProgressBar::with_draw_target(Some(len), target).with_style(style.expect("the template is a constant"))
}

/// A bar that observes work of several stages, of which it shows the one at hand. A signal stops the work.
pub(crate) struct ObserverBar {
    bar: ProgressBar,
    stage: String,
}

impl ObserverBar {
    pub(crate) fn new(common: &Common) -> Self {
        Self { bar: bar(common, 0), stage: String::new() }
    }
}

impl Observer for ObserverBar {
    fn observe(&mut self, progress: Progress<'_>) -> Result<(), EngineError> {
        let Progress { stage, done, total } = progress;
        self.bar.set_length(total.unwrap_or(done).max(done));
        self.bar.set_position(done);
        if self.stage != stage {
            stage.clone_into(&mut self.stage);
            self.bar.set_message(self.stage.clone());
        }
        stop::check()
    }
}

impl Drop for ObserverBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
