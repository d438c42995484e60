//! What `trace` found, in plain words.

use guard4d_engine::detect::trace::{Named, Report, Tracing};

use super::report::{power, table};
use super::verification::found_in_words;

/// What a p-value is not.
pub(crate) const NOT_INNOCENCE: &str = "The p-value says how rarely chance alone would point at anybody so clearly. It \
                                        is not the probability that a recipient is innocent, and says nothing of how a \
                                        copy left.";

/// The verdict, who is named, and what the numbers are not.
pub(crate) fn human(report: &Report) -> String {
    let mut lines = vec![headline(report)];
    lines.extend(report.copies.iter().map(named));
    if report.verdict == Tracing::Traced {
        lines.push(NOT_INNOCENCE.to_owned());
    }
    let required = report.required_score.map_or_else(|| "no score names a copy here".to_owned(), |t| format!("{t:.1}"));
    let decoys = &report.decoys;
    let mut rows = vec![
        (
            "a copy of this issue at all",
            format!("p <= {}, score {:.1}", power(report.owner.log10_p), report.owner.score),
        ),
        (
            "copies scored",
            format!("{}, best score {:.1}; a name wants {required}", report.copies_scored, report.best_score),
        ),
        (
            "copies that were never made",
            format!(
                "{}: mean {:.2}, variance {:.2}, largest {:.1}",
                decoys.count, decoys.mean, decoys.variance, decoys.largest
            ),
        ),
    ];
    if report.frames > 0 {
        rows.push(("frames", report.frames.to_string()));
    }
    for drawn in &report.drawn_as {
        rows.push(("drawn as by", drawn.settings.to_string()));
    }
    for found in &report.located {
        rows.push(("cameras found", found_in_words(found)));
    }
    lines.push(table(&rows));
    lines.join("\n")
}

/// The verdict in a sentence.
pub(crate) fn headline(report: &Report) -> String {
    match report.verdict {
        Tracing::Traced if report.copies.len() == 1 => "TRACED: one copy contributed".to_owned(),
        Tracing::Traced => format!("TRACED: at least {} copies contributed", report.copies.len()),
        Tracing::None => "NONE: this shows no copy of this issue; one would have been found".to_owned(),
        Tracing::Inconclusive if report.frames == 0 && !report.located.is_empty() => {
            "INCONCLUSIVE: the original was not found in this film".to_owned()
        }
        Tracing::Inconclusive if report.owner.log10_p <= report.fpr.log10() => {
            "INCONCLUSIVE: this is a copy of this issue, and too little is seen to say whose".to_owned()
        }
        Tracing::Inconclusive => "INCONCLUSIVE: too little is seen to say whether a copy contributed".to_owned(),
    }
}

fn named(copy: &Named) -> String {
    let who = copy.recipient.clone().unwrap_or_else(|| "a recipient that the ledger does not know".to_owned());
    let p = power(copy.log10_p_family);
    format!("  copy {} of {who} contributed: p <= {p} for all copies together, score {:.1}", copy.copy, copy.score)
}
