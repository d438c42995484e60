//! The page of a trace: who is named, how rare that is, what was compared, and what it does not show.

use std::path::PathBuf;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::detect::exhibit::Beside;
use guard4d_engine::detect::trace::{Named, Report, Tracing};
use guard4d_engine::error::EngineError;
use guard4d_engine::release::receipt::Tool;
use maud::{Markup, PreEscaped, html};

use super::chart::Scores;
use super::films::{Compared, compared};
use super::page::{Page, page};
use super::record::Repeat;
use super::text::{file_name, plain};
use super::verdict_page::SCRIPT;
use crate::ui::report::power;
use crate::ui::tracing_report::{NOT_INNOCENCE, headline};

/// A file that took part.
pub(crate) struct Part {
    pub(crate) what: &'static str,
    pub(crate) path: PathBuf,
    pub(crate) hash: Digest,
}

/// What the page tells of.
pub(crate) struct TraceDocument<'a> {
    /// What was found.
    pub(crate) report: &'a Report,
    /// Frames beside the original; none of an asset.
    pub(crate) beside: &'a [Beside],
    /// What was read.
    pub(crate) parts: &'a [Part],
    /// The root over the issue and its copies, which a date can be under.
    pub(crate) root: Digest,
    /// How it was done.
    pub(crate) repeat: Repeat,
}

impl TraceDocument<'_> {
    /// The page. All that it shows and does is inside.
    ///
    /// # Errors
    /// Those of comparing pictures.
    pub(crate) fn html(&self) -> Result<String, EngineError> {
        let figures =
            self.beside.iter().enumerate().map(|(at, beside)| figure(at, beside)).collect::<Result<Vec<_>, _>>()?;
        let content = html! {
            (self.verdict())
            (self.scores())
            @if !figures.is_empty() {
                h2 { "What was compared" }
                p.soft { "Some of " (self.report.frames) " frames, each beside the original from the same camera." }
                @for figure in figures { (figure) }
            }
            (self.limits())
            (self.rests_on())
        };
        let title = format!("guard4d: {}", word(self.report.verdict));
        Ok(page(Page { title: &title, content, script: SCRIPT }))
    }

    fn verdict(&self) -> Markup {
        let class = match self.report.verdict {
            Tracing::Traced => "verdict present",
            Tracing::None => "verdict absent",
            Tracing::Inconclusive => "verdict inconclusive",
        };
        html! {
            h1 { "Whose copy is it?" }
            div class=(class) {
                b { (word(self.report.verdict)) }
                p { (headline(self.report)) "." }
            }
            @if !self.report.copies.is_empty() {
                table {
                    thead { tr { th { "recipient" } th { "copy" } th { "p-value, all copies" } th { "score" } } }
                    tbody {
                        @for copy in &self.report.copies {
                            tr {
                                td { bdi { (recipient(copy)) } }
                                td { (copy.copy) }
                                td { "at most " (power(copy.log10_p_family)) }
                                td { (format!("{:.1}", copy.score)) }
                            }
                        }
                    }
                }
            }
        }
    }

    fn scores(&self) -> Markup {
        let Report { copies, copies_scored, best_score, required_score, decoys, owner, fpr, .. } = self.report;
        let named: Vec<f64> = copies.iter().map(|copy| copy.score).collect();
        let told = format!(
            "Scores of {} copies that were never made, in deviations: mean {:.2}, variance {:.2}, largest {:.1}.",
            decoys.count, decoys.mean, decoys.variance, decoys.largest
        );
        html! {
            h2 { "How rare that is" }
            p {
                "All " (copies_scored) " copies were scored; the best has " (format!("{best_score:.1}")) ". "
                "Anybody is named by chance in at most " (power(fpr.log10())) " of films, whatever they show. "
                "That this is a copy of this issue at all has p at most " (power(owner.log10_p)) "."
            }
            figure.chart {
                div role="img" aria-label=(told) {
                    (PreEscaped(Scores { decoys: &decoys.counts, named: &named, required: *required_score }.svg()))
                }
                figcaption { (told) " The dots are the copies that are named." }
            }
        }
    }

    fn limits(&self) -> Markup {
        html! {
            h2 { "What this does not show" }
            ul {
                @if self.report.verdict == Tracing::Traced {
                    li { (NOT_INNOCENCE) }
                    li { "It does not show that nobody else contributed." }
                }
                li {
                    "Who holds the ledger could have stamped a copy himself. A dated root from before the copies left, "
                    "and a record of each delivery, answer that."
                }
            }
        }
    }

    fn rests_on(&self) -> Markup {
        let Tool { version, git_revision } = Tool::current();
        html! {
            h2 { "What it rests on" }
            dl {
                @for Part { what, path, hash } in self.parts {
                    dt { (what) }
                    dd { bdi { (file_name(&path.to_string_lossy())) } " " code { (hash) } }
                }
                dt { "root of the issue and its copies" }
                dd { code { (self.root) } }
            }
            p.soft { "All hashes are BLAKE3. " code { "guard4d ledger commit" } " writes the root." }
            h2 { "How to repeat it" }
            p {
                "With guard4d " (version)
                @if let Some(revision) = git_revision { ", revision " code { (revision) } }
                ", the original and the ledger:"
            }
            pre tabindex="0" { (plain(&self.repeat.command)) }
            p.soft { "It was run on " (plain(&self.repeat.device)) ". Other devices differ in the last digits." }
        }
    }
}

const fn word(verdict: Tracing) -> &'static str {
    match verdict {
        Tracing::Traced => "TRACED",
        Tracing::None => "NONE",
        Tracing::Inconclusive => "INCONCLUSIVE",
    }
}

fn recipient(copy: &Named) -> String {
    copy.recipient.as_deref().map_or_else(|| "not in the ledger".to_owned(), plain)
}

fn figure(at: usize, beside: &Beside) -> Result<Markup, EngineError> {
    let Beside { film, original } = beside;
    let name = format!("Frame {} of {}", film.frame, file_name(&film.clip));
    let caption = html! { bdi { (name) } ": " (format!("{:.1}", beside.psnr()?.0)) " dB from the original." };
    let of_original = "the original from the same camera";
    compared(&Compared { at, film: &film.picture, original, name: &name, of_original }, &caption)
}
