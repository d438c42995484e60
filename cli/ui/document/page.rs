//! The page as a whole.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use guard4d_engine::detect::report::VerifyReport;
use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use maud::{DOCTYPE, PreEscaped, html};
use sha2::{Digest as _, Sha256};

use super::record::Repeat;
use super::{films, readings, record, verdict};

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("compare.js");

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
    /// The page. All that it shows and does is inside, and it forbids browsers to fetch anything.
    ///
    /// # Errors
    /// Those of comparing pictures.
    pub(crate) fn html(&self) -> Result<String, EngineError> {
        let Self { report, clean, repeat } = self;
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta http-equiv="Content-Security-Policy" content=(policy());
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="referrer" content="no-referrer";
                    title { "guard4d: " (verdict::word(report.evidence.verdict)) }
                    style { (PreEscaped(STYLE)) }
                }
                body {
                    main {
                        (verdict::section(report))
                        (films::section(report, clean)?)
                        (readings::section(report))
                        (record::section(report, repeat))
                    }
                    script { (PreEscaped(SCRIPT)) }
                }
            }
        };
        Ok(page.into_string())
    }
}

/// Pictures inside the page, and no style or script but the page's own.
fn policy() -> String {
    let hash = |text: &str| format!("'sha256-{}'", BASE64_STANDARD.encode(Sha256::digest(text)));
    format!(
        "default-src 'none'; img-src data:; style-src {}; script-src {}; base-uri 'none'; form-action 'none'",
        hash(STYLE),
        hash(SCRIPT)
    )
}
