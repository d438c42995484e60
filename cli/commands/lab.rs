//! `guard4d lab`, which the lab's own crate runs.

use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::Precision;
use guard4d_lab::command::{Host, LabArgs};
use indicatif::ProgressBar;
use serde_json::Value;

use crate::flags::common::Common;
use crate::shared::device;
use crate::ui::outcome::Outcome;
use crate::ui::progress::bar;
use crate::ui::{report, stop};

pub(crate) fn run(args: &LabArgs, common: &Common) -> Result<Outcome, EngineError> {
    guard4d_lab::command::run(args, &Program(common))?;
    Ok(Outcome::Done)
}

/// This program, with the flags that it was started with.
struct Program<'a>(&'a Common);

impl Host for Program<'_> {
    fn open(&self) -> Result<Device, EngineError> {
        device::open(self.0)
    }

    fn precision(&self) -> Precision {
        self.0.device.precision
    }

    fn note(&self, words: &str) {
        report::note(self.0, words);
    }

    fn print(&self, json: &Value, words: &str) -> Result<(), EngineError> {
        report::print(self.0, json, |_| words.to_owned())
    }

    fn progress(&self, len: u64) -> ProgressBar {
        bar(self.0, len)
    }

    fn listen(&self) {
        stop::listen(self.0);
    }

    fn is_stopped(&self) -> bool {
        stop::is_requested()
    }
}
