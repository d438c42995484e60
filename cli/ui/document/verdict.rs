//! The verdict in one sentence, how rare it is, and what was asked.

use guard4d_engine::detect::compared_message::ComparedMessage;
use guard4d_engine::detect::owner_chips::ChipsReading;
use guard4d_engine::detect::report::{IdEvidence, VerifyReport};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::id_code::SearchedP;
use guard4d_engine::evidence::judgement::{PStatement, Verdict};
use guard4d_engine::evidence::thresholds::DecisionStatistic;
use maud::{Markup, PreEscaped, html};

use super::chart::Rarity;
use super::text::{once_in, plain};
use crate::ui::verification::{
    chips_in_words, choices_row, compared_in_words, framed_row, id_rows, p_in_words, undone_in_words,
};

/// The verdict as a word.
pub(super) const fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Present => "PRESENT",
        Verdict::Absent => "ABSENT",
        Verdict::Inconclusive => "INCONCLUSIVE",
    }
}

pub(super) fn section(report: &VerifyReport) -> Markup {
    let evidence = &report.evidence;
    let class = match report.verdict {
        Verdict::Present => "verdict present",
        Verdict::Absent => "verdict absent",
        Verdict::Inconclusive => "verdict inconclusive",
    };
    html! {
        h1 { "Does this film carry the owner's mark?" }
        div class=(class) {
            b { (word(report.verdict)) }
            p { (sentence(report)) }
        }
        h2 { "How rare that is" }
        (rarity(report))
        @if let Some(said) = &report.compared_message {
            h2 { "The message beside the original" }
            p { "Each frame compared with the original's, from the film's cameras: " (compared_in_words(said)) "." }
        }
        @if let Some(chips) = &report.owner_chips {
            h2 { "The owner's chips" }
            p { "Compared with the original from the film's cameras: " (chips_in_words(chips)) "." }
        }
        h2 { "Why" }
        ul { @for reason in &evidence.reasons { li { (plain(&reason.to_string())) } } }
        h2 { "What was asked" }
        (asked(report))
    }
}

/// The verdict in one plain sentence.
fn sentence(report: &VerifyReport) -> String {
    let evidence = &report.evidence;
    let agree = format!("{} of {} bits agree with the message of the receipt", evidence.matches, evidence.num_bits);
    if let Some(ChipsReading { proves: true, frames, .. }) = &report.owner_chips {
        return format!(
            "The film shows the owner's asset: the chips in its {frames} frames are those of the owner's key. {agree}."
        );
    }
    if let Some(ComparedMessage { proves: true, matches, num_bits, frames, .. }) = &report.compared_message {
        return format!(
            "The film carries the mark: beside the original, {matches} of {num_bits} bits in its {frames} frames agree \
             with the message of the receipt."
        );
    }
    match (evidence.verdict, chance(report)) {
        (Verdict::Present, Some(Chance { p, most })) => {
            format!(
                "The film carries the mark: {agree}, and a random message would agree so well {most}{}.",
                once_in(p)
            )
        }
        (Verdict::Present, None) => {
            format!("The film carries the mark, by counted errors and not by an exact test: {agree}.")
        }
        (Verdict::Absent, _) => {
            format!("No mark was found: {agree}, as chance would have it. That does not show that none was ever there.")
        }
        (Verdict::Inconclusive, _) => {
            format!("Whether the film carries the mark cannot be said: {agree}. The reasons are below.")
        }
    }
}

/// How rare the film's agreement is.
struct Chance {
    p: f64,
    /// What stands before it where it is a bound.
    most: &'static str,
}

/// Of the statistic that decides; none without a p-value.
fn chance(report: &VerifyReport) -> Option<Chance> {
    let of = |matches: f64, soft_score: f64| match report.evidence.thresholds.statistic {
        DecisionStatistic::Matches => matches,
        DecisionStatistic::SoftScore => soft_score,
    };
    match report.evidence.p_value {
        PStatement::Exact { matches, soft_score } => Some(Chance { p: of(matches, soft_score), most: "" }),
        PStatement::Searched(SearchedP { matches, soft_score, .. }) => {
            Some(Chance { p: of(matches, soft_score), most: "at most " })
        }
        PStatement::NotCommitted(_) | PStatement::Empirical { .. } => None,
    }
}

fn rarity(report: &VerifyReport) -> Markup {
    let evidence = &report.evidence;
    let Some(Chance { p, most }) = chance(report) else {
        return html! { p { "There is no p-value: " (p_in_words(&evidence.p_value)) "." } };
    };
    let (heads, needed) = (Rarity::heads(p), Rarity::heads(evidence.thresholds.fpr));
    // Each bit is a toss; what was chosen from several takes tosses away.
    let least = 2.0_f64.powi(-evidence.num_bits.cast_signed());
    let told = format!(
        "As rare as a coin that falls heads {heads:.0} times in a row. The receipt asks for {needed:.0} times."
    );
    html! {
        p { "p-value: " (p_in_words(&evidence.p_value)) ". That happens by chance " (most) (once_in(p)) "." }
        figure.chart {
            div role="img" aria-label=(told) {
                (PreEscaped(Rarity { p, fpr: evidence.thresholds.fpr, least }.svg()))
            }
            figcaption { (told) " The scale is in powers of ten." }
        }
    }
}

fn asked(report: &VerifyReport) -> Markup {
    let choices = choices_row(&report.choices).1;
    html! {
        dl {
            dt { "message" }
            dd {
                @match &report.id {
                    Some(IdEvidence { promised, .. }) => { "the one of the receipt, for the number " (promised) },
                    None => { "the one that the receipt commits to" },
                }
            }
            dt { "extractor" }
            dd { (report.evidence.mode) ", " (in_words(report.evidence.mode)) }
            @for row in report.id.iter().flat_map(id_rows) { dt { (row.0) } dd { (row.1) } }
            @if let Some(undone) = &report.undone { dt { "undone" } dd { (undone_in_words(undone)) } }
            @for row in report.clips.iter().filter_map(framed_row) { dt { (row.0) } dd { (plain(&row.1)) } }
            dt { "chosen by hand" }
            dd { (choices) }
        }
    }
}

const fn in_words(mode: ExtractorMode) -> &'static str {
    if mode.is_message_blind() { "made without the message" } else { "trained with the message" }
}
