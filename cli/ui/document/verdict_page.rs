//! The page of a verdict as a whole.

use guard4d_engine::detect::report::VerifyReport;
use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use maud::html;

use super::page::{Page, page};
use super::record::Repeat;
use super::{films, readings, record, verdict};

pub(super) const SCRIPT: &str = include_str!("compare.js");

/// What the page tells of.
pub(crate) struct Document<'a> {
    /// The verification.
    pub(crate) report: &'a VerifyReport,
    /// Views of the original, one list for each, if whoever verifies has it.
    pub(crate) clean: &'a [Vec<Frame>],
    /// How it was done.
    pub(crate) repeat: Repeat,
}

impl Document<'_> {
    /// The page. All that it shows and does is inside.
    ///
    /// # Errors
    /// Those of comparing pictures.
    pub(crate) fn html(&self) -> Result<String, EngineError> {
        let Self { report, clean, repeat } = self;
        let content = html! {
            (verdict::section(report))
            (films::section(report, clean)?)
            (readings::section(report))
            (record::section(report, repeat))
        };
        let title = format!("guard4d: {}", verdict::word(report.verdict));
        Ok(page(Page { title: &title, content, script: SCRIPT }))
    }
}
