//! How a farm's manifest stands, as one page: failures first.

use std::fs;
use std::path::Path;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use guard4d_engine::farm::ledger::{JobFigures, Mark, Span};
use guard4d_engine::farm::status::Status;
use maud::{Markup, PreEscaped, html};

use super::chart::{Bar, timeline};
use super::page::{Page, page};
use super::text::plain;

/// Most rows of a table. A page of a hundred thousand rows is opened by nobody; the ledger has them.
const LISTED: usize = 200;
/// Largest picture that is put into the page, bytes.
const MAX_PICTURE: u64 = 1 << 20;

/// What the page tells of.
pub(crate) struct FarmDocument<'a> {
    /// Of the manifest.
    pub(crate) name: &'a str,
    pub(crate) status: &'a Status,
    pub(crate) jobs: &'a [JobFigures],
    /// The worst first.
    pub(crate) marks: &'a [Mark],
    /// In the order of their ends.
    pub(crate) spans: &'a [Span],
    pub(crate) pictures: Vec<Picture>,
}

/// A marked frame.
pub(crate) struct Picture {
    id: String,
    png: Vec<u8>,
}

impl Picture {
    /// The first frame of the preview that lies beside a mark, if it is there and not too large.
    pub(crate) fn of(folder: &Path, mark: &Mark) -> Option<Self> {
        let path = folder.join(&mark.output).join("preview/00000.png");
        let is_small = fs::metadata(&path).is_ok_and(|data| data.len() <= MAX_PICTURE);
        let png = if is_small { fs::read(path).ok()? } else { return None };
        Some(Self { id: mark.id.clone(), png })
    }
}

impl FarmDocument<'_> {
    /// The page. All that it shows is inside, and it forbids browsers to fetch anything.
    pub(crate) fn html(&self) -> String {
        let Status { rows, done, failed, .. } = self.status;
        let name = plain(self.name);
        let (class, word) = match (*failed, rows - done) {
            (0, 0) => ("verdict present", "DONE"),
            (0, _) => ("verdict", "NOT DONE YET"),
            _ => ("verdict inconclusive", "SOME FAILED"),
        };
        let content = html! {
            h1 { "What became of " (name) }
            div class=(class) {
                b { (word) }
                p { (done) " of " (rows) " rows are done, " (failed) " have failed." }
            }
            (self.failures())
            (self.figures())
            (self.marks())
            (self.pictures())
            (self.timeline())
        };
        page(Page { title: &format!("guard4d farm: {name}"), content, script: "" })
    }

    fn failures(&self) -> Markup {
        let failures = self.status.failures.iter().flat_map(|(code, rows)| rows.iter().map(move |row| (code, row)));
        html! {
            @if self.status.failed > 0 {
                h2 { "Failures" }
                table {
                    thead { tr { @for head in ["row", "exit code", "why"] { th scope="col" { (head) } } } }
                    tbody {
                        @for (code, row) in failures.take(LISTED) {
                            tr { th scope="row" { (plain(&row.id)) } td { (code) } td.fires { (plain(&row.error)) } }
                        }
                    }
                }
                (more(self.status.failed))
            }
        }
    }

    fn figures(&self) -> Markup {
        let Status { running, interrupted, pending, seconds, seconds_left, .. } = self.status;
        html! {
            h2 { "Figures" }
            dl {
                dt { "running, interrupted, not begun" } dd { (running) ", " (interrupted) ", " (pending) }
                dt { "work done" } dd { (format!("{seconds:.0} s")) }
                @if let Some(left) = seconds_left { dt { "work left, about" } dd { (format!("{left:.0} s")) } }
            }
            table {
                thead {
                    tr { @for head in ["job", "done", "s at the median", "s at most"] { th scope="col" { (head) } } }
                }
                tbody {
                    @for job in self.jobs {
                        tr {
                            th scope="row" { (plain(&job.job)) }
                            td { (job.done) }
                            td { (format!("{:.2}", job.median_s)) }
                            td { (format!("{:.2}", job.most_s)) }
                        }
                    }
                }
            }
        }
    }

    fn marks(&self) -> Markup {
        html! {
            @if !self.marks.is_empty() {
                h2 { "Marks" }
                p.soft { "The worst first, as the embedding measured them." }
                table {
                    thead { tr { @for head in ["row", "bits right", "PSNR", "seconds"] { th scope="col" { (head) } } } }
                    tbody {
                        @for mark in self.marks.iter().take(LISTED) {
                            tr {
                                th scope="row" { (plain(&mark.id)) }
                                td { (format!("{:.1} %", 100.0 * mark.bit_accuracy)) }
                                td { (mark.psnr_db.map_or("-".to_owned(), |psnr| format!("{psnr:.1} dB"))) }
                                td { (format!("{:.1}", mark.seconds)) }
                            }
                        }
                    }
                }
                (more(self.marks.len()))
            }
        }
    }

    fn pictures(&self) -> Markup {
        html! {
            @if !self.pictures.is_empty() {
                h2 { "Pictures" }
                p.soft { "A frame with its mark, of the marks that are read worst." }
                div.looks {
                    @for Picture { id, png } in &self.pictures {
                        figure.alone {
                            img alt=(format!("a marked frame of {}", plain(id)))
                                src=(format!("data:image/png;base64,{}", BASE64_STANDARD.encode(png)));
                            figcaption { (plain(id)) }
                        }
                    }
                }
            }
        }
    }

    /// A line for each worker, with its rows as bars.
    fn timeline(&self) -> Markup {
        let begun = |span: &Span| span.ended_unix_s - span.seconds;
        let first = self.spans.iter().map(begun).fold(f64::INFINITY, f64::min);
        let mut workers: Vec<&str> = self.spans.iter().map(|span| span.worker.as_str()).collect();
        workers.sort_unstable();
        workers.dedup();
        let bar = |span: &Span| Bar {
            line: workers.binary_search(&span.worker.as_str()).unwrap_or_default(),
            from: begun(span) - first,
            to: span.ended_unix_s - first,
            good: span.is_done,
        };
        let bars: Vec<Bar> = self.spans.iter().map(bar).collect();
        let told = format!("{} attempts by {} workers", bars.len(), workers.len());
        html! {
            @if !bars.is_empty() {
                h2 { "When" }
                figure.chart {
                    div role="img" aria-label=(told) { (PreEscaped(timeline(&bars, workers.len()))) }
                    figcaption {
                        (told) ", a line for each worker, from the first to the last second by their clocks. "
                        "Those that did not end well are orange."
                    }
                }
            }
        }
    }
}

/// Says that a table is cut.
fn more(rows: usize) -> Markup {
    html! {
        @if rows > LISTED { p.soft { "And " (rows - LISTED) " more, in the ledger." } }
    }
}
