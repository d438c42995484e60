//! Bits and controls.

use guard4d_engine::detect::report::{BitReading, VerifyReport};
use guard4d_engine::evidence::control::{ControlKind, ControlResult, ControlState};
use guard4d_engine::evidence::other_keys::OtherKeysResult;
use maud::{Markup, PreEscaped, html};

use super::chart::{Share, margins};
use super::text::plain;
use crate::ui::verification::{other_keys_in_words, pool_in_words};

pub(super) fn section(report: &VerifyReport) -> Markup {
    html! {
        h2 { "Bit by bit" }
        (bits(&report.bits))
        h2 { "Controls" }
        (controls(report))
    }
}

fn bits(bits: &[BitReading]) -> Markup {
    let signed = |bit: &BitReading| if bit.claimed { bit.logit } else { -bit.logit };
    let signed: Vec<f64> = bits.iter().map(signed).collect();
    let agree = bits.iter().filter(|bit| bit.agrees()).count();
    let told = format!("{agree} of {} bits read as claimed: bars upwards. The others point downwards.", bits.len());
    let bit = |one: bool| if one { "1" } else { "0" };
    html! {
        figure.chart {
            div role="img" aria-label=(told) { (PreEscaped(margins(&signed))) }
            figcaption { (told) " A long bar is a bit that the film is sure of." }
        }
        details {
            summary { "All bits as numbers" }
            table {
                thead {
                    tr { @for head in ["bit", "claimed", "read", "mean logit"] { th scope="col" { (head) } } }
                }
                tbody {
                    @for (at, reading) in bits.iter().enumerate() {
                        tr class=[(!reading.agrees()).then_some("fires")] {
                            th scope="row" { (at) }
                            td { (bit(reading.claimed)) }
                            td { (bit(reading.logit > 0.0)) }
                            td { (format!("{:.3}", reading.logit)) }
                        }
                    }
                }
            }
        }
    }
}

fn controls(report: &VerifyReport) -> Markup {
    let evidence = &report.evidence;
    let panel = &evidence.panel;
    let claim = Share { matches: evidence.matches, num_bits: evidence.num_bits, band: None, good: true };
    html! {
        p {
            "None of these may find the message. The grey band is what chance keeps to; the film itself stands above "
            "them. If one of them is not at chance, the verdict cannot be PRESENT. Arithmetic checks are at chance "
            "whatever the extractor is: they would show a mistake in the program, and nothing about an owner."
        }
        table.controls {
            thead {
                tr { @for head in ["what was read", "bits that agree", "of all bits"] { th scope="col" { (head) } } }
            }
            tbody {
                tr {
                    th scope="row" { "the film" }
                    td { (evidence.matches) " of " (evidence.num_bits) }
                    td.line aria-hidden="true" { (PreEscaped(claim.svg())) }
                }
                @for control in &panel.supplied { (control_row(control)) }
                (control_row(&panel.inverted))
            }
        }
        ul {
            @for pool in &panel.pools {
                li class=[fires(pool.state)] { (pool_in_words(pool)) (state_in_words(pool.state)) }
            }
            (other_keys(ControlKind::OtherMessages, &panel.other_messages))
            (other_keys(ControlKind::OtherReadings, &panel.other_readings))
        }
    }
}

fn control_row(control: &ControlResult) -> Markup {
    let deviation = &control.chance_deviation;
    let quiet = deviation.state == ControlState::Quiet;
    // The inverted message disagrees with a marked film as much as the message agrees: only too many matches count.
    let low = if control.kind == ControlKind::InvertedMessage { 0 } else { deviation.band_low };
    let band = Some((low, deviation.band_high));
    let share = Share { matches: deviation.matches, num_bits: deviation.num_bits, band, good: quiet };
    html! {
        tr {
            th scope="row" class=[fires(deviation.state)] {
                @if control.kind == ControlKind::InvertedMessage { "arithmetic check, " }
                (control.kind) ": " bdi { (plain(&control.name)) } (state_in_words(deviation.state))
            }
            td { (deviation.matches) " of " (deviation.num_bits) }
            td.line aria-hidden="true" { (PreEscaped(share.svg())) }
        }
    }
}

fn other_keys(kind: ControlKind, result: &OtherKeysResult) -> Markup {
    html! {
        li class=[fires(result.state)] {
            "arithmetic check, " (kind) ": " (other_keys_in_words(result)) (state_in_words(result.state))
        }
    }
}

fn fires(state: ControlState) -> Option<&'static str> {
    (state == ControlState::Fires).then_some("fires")
}

const fn state_in_words(state: ControlState) -> &'static str {
    match state {
        ControlState::Fires => " – not at chance",
        ControlState::Quiet => "",
    }
}
