//! What a command says: its result on stdout, as a table or as JSON, and notes on stderr.

use std::collections::BTreeMap;
use std::io::Write as _;

use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::release::evaluate::{ClassFigure, Evaluation};
use guard4d_engine::scene::camera::classes::CameraClass;
use serde::Serialize;

use crate::flags::common::Common;

/// Prints `value` as JSON when asked for, else the lines of `human`.
pub(crate) fn print<T: Serialize>(
    common: &Common,
    value: &T,
    human: impl FnOnce(&T) -> String,
) -> Result<(), EngineError> {
    if let Some(session) = &common.session {
        session.keep_result(serde_json::to_value(value).expect("report types hold nothing that JSON cannot"));
        return Ok(());
    }
    let text = if common.json {
        serde_json::to_string_pretty(value).expect("report types hold nothing that JSON cannot")
    } else {
        human(value)
    };
    print_text(&format!("{text}\n"))
}

/// Prints text as it is.
pub(crate) fn print_text(text: &str) -> Result<(), EngineError> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        // A reader that has seen enough (`| head`) is no failure.
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        Err(source) => Err(EngineError::Io { path: "stdout".into(), source }),
        Ok(()) => Ok(()),
    }
}

/// Says something to whoever watches, unless asked to be quiet.
pub(crate) fn note(common: &Common, text: &str) {
    if !common.quiet {
        say(text);
    }
}

/// Says something on stderr. That nobody listens is no failure, and must not cost a result that is not yet in its
/// place.
pub(crate) fn say(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Two columns, aligned.
pub(crate) fn table(rows: &[Row]) -> String {
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    rows.iter().map(|(name, value)| format!("  {name:width$}  {value}")).collect::<Vec<_>>().join("\n")
}

/// A line of a table.
pub(crate) type Row = (&'static str, String);

/// What was read from held-out frames, for people.
pub(crate) fn reading_rows(e: &Evaluation) -> Vec<Row> {
    let mut rows = vec![
        ("extractor", e.mode.to_string()),
        ("evidence", evidence_in_words(e.mode, e.key_rotation.of > 1).to_owned()),
        ("bits right, marked clips", format!("{} of {} clips x {} bits", percent(e.marked), e.clips, e.bits)),
        ("messages without a wrong bit", format!("{} of {} clips", e.exact(), e.clips)),
    ];
    rows.extend(e.ids.map(|ids| ("the number, best of all", format!("{ids} of {} clips", e.clips))));
    let rest = [
        ("bits right, single frames", percent(e.marked_frames)),
        ("clean control (50 % is chance)", percent(e.clean)),
        ("noisy control (50 % is chance)", percent(e.noisy)),
    ];
    rows.extend(rest);
    let in_class = |(class, figure): (&CameraClass, &ClassFigure)| format!("{class} {}", percent(figure.bit_accuracy));
    let classes: Vec<String> = e.classes.iter().map(in_class).collect();
    if let Some(ClassFigure { films, .. }) = e.classes.values().next() {
        rows.push(("bits right, other cameras", format!("{}; {films} films each", classes.join(", "))));
    }
    rows
}

/// How well held-out frames were kept and what that took in time and device memory, for people.
pub(crate) fn cost_rows(e: &Evaluation, seconds: &BTreeMap<String, f64>, peak_memory_bytes: u64) -> Vec<Row> {
    let stages: Vec<String> = seconds.iter().map(|(stage, s)| format!("{stage} {s:.1}")).collect();
    let mut rows = vec![
        ("PSNR whole frame", format!("{:.2} dB", e.psnr.mean_of_views_db.0)),
        ("PSNR object only", format!("{:.2} dB", e.foreground_psnr.mean_of_views_db.0)),
        (
            "colour difference, object (CIEDE2000)",
            format!("{:.2}, one pixel in twenty above {:.2}", e.colour_difference.mean, e.colour_difference.p95),
        ),
        ("SSIM", format!("{:.4}", e.ssim)),
    ];
    rows.extend(e.lpips.map(|lpips| ("LPIPS", format!("{lpips:.5}"))));
    rows.push(("seconds", stages.join(", ")));
    rows.push(("device memory at its peak", format!("{:.1} MB", peak_memory_bytes as f64 * 1e-6)));
    rows
}

/// A share as people read it.
pub(crate) fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// What kind of evidence a mode can give.
pub(crate) fn evidence_in_words(mode: ExtractorMode, is_chosen: bool) -> &'static str {
    match (mode.is_message_blind(), is_chosen) {
        (true, false) => "exact p-value: the extractor never saw the message",
        (true, true) => {
            "p-value at most: a rotation, an edit or a receipt was chosen with the message in hand, and all that could \
             have been are counted"
        }
        (false, _) => "empirical only: the extractor was trained with the message and may hold it itself",
    }
}

/// 10 to this power, however small.
pub(crate) fn power(log10: f64) -> String {
    if log10 > -3.0 {
        return format!("{:.3}", 10f64.powf(log10));
    }
    let exponent = log10.floor();
    format!("{:.1}e{exponent:.0}", 10f64.powf(log10 - exponent))
}
