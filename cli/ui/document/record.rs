//! What the verdict does not show, what it rests on, and how somebody else repeats it.

use std::ffi::OsString;

use guard4d_engine::detect::free_part::{Checked, FreePart};
use guard4d_engine::detect::report::VerifyReport;
use guard4d_engine::device::Device;
use guard4d_engine::evidence::judgement::Verdict;
use guard4d_engine::release::delivery::EXTRACTOR;
use guard4d_engine::release::receipt::Tool;
use maud::{Markup, html};

use super::text::plain;
use crate::ui::dates::{date_in_words, not_shown, root_in_words};
use crate::ui::verification::free_part_in_words;

/// How somebody else does it again.
pub(crate) struct Repeat {
    /// The command.
    pub(crate) command: String,
    /// Name of the device.
    pub(crate) device: String,
}

impl Repeat {
    /// What runs now.
    pub(crate) fn now(device: &Device) -> Self {
        Self { command: repeated(std::env::args_os()), device: device.info().name.clone() }
    }
}

pub(super) fn section(report: &VerifyReport, repeat: &Repeat) -> Markup {
    html! {
        h2 { "What this does not show" }
        ul { @for limit in limits(report) { li { (limit) } } }
        h2 { "What it rests on" }
        (rests_on(report))
        h2 { "How to repeat it" }
        (again(report, repeat))
    }
}

fn limits(report: &VerifyReport) -> Vec<String> {
    let mut limits = vec![format!("It does not show {}.", not_shown(&report.standing))];
    if report.verdict != Verdict::Present {
        let removed = "It does not show that the film is free of the owner's work: compression, edits or an attack can \
                       remove a mark.";
        limits.push(removed.to_owned());
    }
    limits.push("It does not show who made the film or passed it on, nor who has the right to the scene.".to_owned());
    if matches!(report.free_part, FreePart { checked: Checked::NotChecked, .. }) {
        limits.push(format!("The extractor's free part was not checked: {}.", free_part_in_words(&report.free_part)));
    }
    if report.choices.claims == 1 {
        let counted = "It holds for a claim that was the only one. Whoever tried several films, receipts or readings \
                       has to say so, and each counts.";
        limits.push(counted.to_owned());
    }
    let not_run: Vec<String> = report.evidence.panel.not_run.iter().map(ToString::to_string).collect();
    if !not_run.is_empty() {
        limits.push(format!("These controls were not run: {}.", not_run.join(", ")));
    }
    limits
}

fn rests_on(report: &VerifyReport) -> Markup {
    let promise = &report.promise;
    html! {
        dl {
            dt { "commitment" }
            dd { code { (report.commitment) } " (" (report.schema) ")" }
            dt { "dated" }
            dd { (plain(&date_in_words(&report.standing))) }
            @if let Some(root) = &report.standing.root { dt { "root" } dd { (root_in_words(root)) } }
            dt { "owner's key" }
            dd { code { (promise.key_id) } }
            @if let Some(anchor) = &promise.anchor {
                dt { "signed by" }
                dd { code { (anchor.signer) } }
                dt { "unmarked asset" }
                dd { code { (anchor.asset) } }
                dt { "with motion and background" }
                dd { code { (anchor.scene) } }
                dt { "all that reads" }
                dd { code { (anchor.reader) } }
            }
            @if let Some(extractor) = &promise.extractor { dt { "extractor" } dd { code { (extractor) } } }
            dt { "the extractor's free part" }
            dd { (free_part_in_words(&report.free_part)) }
            dt { "CLIP" }
            dd { code { (promise.clip) } }
            dt { "decoder" }
            dd { code { (promise.decoder) } }
        }
        p.soft { "All hashes are BLAKE3." }
    }
}

fn again(report: &VerifyReport, repeat: &Repeat) -> Markup {
    let Tool { version, git_revision } = Tool::current();
    html! {
        ol {
            li {
                "Get guard4d " (version)
                @if let Some(revision) = git_revision { ", revision " code { (revision) } }
                "."
            }
            li {
                "Have the owner send what " code { "guard4d disclose" } " writes: the key of this asset, the receipt "
                "and " (EXTRACTOR) ". The receipt must have the commitment above."
            }
            li { "Compare the films' hashes with those above." }
            @if !matches!(report.free_part, FreePart { checked: Checked::Refitted { .. }, .. }) {
                li {
                    "Have the unmarked asset at hand, and add " code { "--original" } ": the free part is then checked."
                }
            }
            li { "Run this, with your own paths:" pre tabindex="0" { (plain(&repeat.command)) } }
        }
        p.soft {
            "It was run on " (plain(&repeat.device)) ". Other devices differ in the last digits of logits. What each "
            "part of this page means, and under which assumptions, is in docs/method/evidence.md of the program."
        }
    }
}

/// The command line as a shell takes it, without what says where results go.
fn repeated(arguments: impl Iterator<Item = OsString>) -> String {
    let mut words = vec!["guard4d".to_owned()];
    let mut skips = false;
    for argument in arguments.skip(1) {
        let word = argument.to_string_lossy();
        let is_output = matches!(&*word, "--overwrite" | "-w" | "--json") || word.starts_with("--report=");
        if !skips && !is_output && word != "--report" {
            words.push(shlex::try_quote(&word).map_or_else(|_| word.to_string(), |quoted| quoted.to_string()));
        }
        skips = !skips && word == "--report";
    }
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_is_repeated_without_its_outputs() {
        let typed = ["/bin/guard4d", "verify", "a b.mp4", "--report", "-w", "-w", "--key", "k", "--report=x", "--json"];
        assert_eq!(repeated(typed.into_iter().map(OsString::from)), "guard4d verify 'a b.mp4' --key k");
    }
}
