//! The paper's Tables 3 and 4: what each term of its loss does, and what each control clip does.

use guard4d_engine::watermark::embed::{ControlClips, EmbedConfig, JointConfig};

use super::methods::{PAPER_ARM, against_psnr, guard4d, point};
use crate::chart::{Axis, Chart, Series};
use crate::report::Report;
use crate::study::plan::{Arm, DEFAULT_BITS, Scale};
use crate::study::summary::{self, Column, Figure, Findings};
use crate::table::Table;

/// What the paper prints: bit accuracy in percent and PSNR in dB (Table 3; its ticks read with its prose, which is the
/// only way that they fit the numbers).
const PRINTED_TERMS: [(&str, &str); 5] = [
    ("without the message loss", "52.52 / inf"),
    ("without the reconstruction loss", "99.92 / 39.96"),
    ("without the offset penalty", "99.97 / 41.67"),
    ("without the control loss", "100.00 / 76.15"),
    (PAPER_ARM, "99.81 / 49.87"),
];

/// What the paper prints: bits of the message in marked, unmarked and noisy unmarked clips, percent (Table 4).
const PRINTED_CONTROLS: [(&str, &str); 4] = [
    ("no controls", "100 / 96.45 / 97.86"),
    ("noisy controls", "99.97 / 52.34 / 51.34"),
    ("clean controls", "99.89 / 49.26 / 49.67"),
    (PAPER_ARM, "99.81 / 47.39 / 46.36"),
];

/// The paper's method with something changed.
fn changed(scale: &Scale, name: &str, change: impl FnOnce(&mut EmbedConfig)) -> Arm {
    let arm = guard4d(scale, DEFAULT_BITS);
    Arm { name: name.to_owned(), config: arm.config.clone().with(change), ..arm }
}

/// What the paper's extractor alone has.
fn joint(config: &mut EmbedConfig) -> &mut JointConfig {
    config.extractor.joint_mut().expect("the paper's method is joint")
}

/// One term less each.
pub(super) fn table3(scale: &Scale) -> Vec<Arm> {
    let [message, recon, offset, control, _] = PRINTED_TERMS.map(|(name, _)| name);
    vec![
        changed(scale, message, |c| c.objective.lambda_msg = 0.0),
        changed(scale, recon, |c| {
            c.objective.lambda_recon = 0.0;
            c.objective.lpips = None;
        }),
        changed(scale, offset, |c| c.objective.lambda_offset = 0.0),
        changed(scale, control, |c| joint(c).lambda_control = 0.0),
        guard4d(scale, DEFAULT_BITS),
    ]
}

/// Control clips one by one.
pub(super) fn table4(scale: &Scale) -> Vec<Arm> {
    let [none, noisy, clean, _] = PRINTED_CONTROLS.map(|(name, _)| name);
    vec![
        changed(scale, none, |c| joint(c).lambda_control = 0.0),
        changed(scale, noisy, |c| joint(c).control_clips = ControlClips::Noisy),
        changed(scale, clean, |c| joint(c).control_clips = ControlClips::Clean),
        guard4d(scale, DEFAULT_BITS),
    ]
}

const COLUMNS: [Column; 11] = [
    summary::ARM,
    summary::ROWS,
    summary::MARKED,
    summary::CLEAN,
    summary::NOISY,
    summary::OTHERS,
    UNTRAINED,
    summary::PSNR,
    summary::SSIM,
    summary::SECONDS,
    summary::ERRORS,
];

/// What the asset alone carries.
pub(super) const UNTRAINED: Column = ("read by R before its training, %", |g| g.percent_range(|r| r.untrained));

/// Our lines, each with the paper's figures behind it.
fn with_printed(findings: &Findings, head: &str, printed: &[(&str, &str)]) -> Table {
    let mut table = summary::table("All scenes", "Means over scenes and seeds.", &COLUMNS, &findings.groups());
    table.head.push(head.to_owned());
    for row in &mut table.rows {
        let line = printed.iter().find(|(arm, _)| row.first().is_some_and(|name| name == arm));
        row.push(line.map(|(_, figures)| (*figures).to_owned()).unwrap_or_default());
    }
    table
}

pub(super) fn report3(findings: &Findings) -> Report {
    Report {
        title: "Terms of the loss (the paper's Table 3)".to_owned(),
        intro: "The paper's method with one term of its loss taken away. A mark that is \"read\" at a PSNR that \
                leaves nothing of it in the asset is the extractor reciting the message: see clean clips and other \
                scenes."
            .to_owned(),
        charts: vec![against_psnr("bits right against PSNR, one term less each", findings)],
        tables: vec![with_printed(findings, "paper: bits right, % / PSNR, dB", &PRINTED_TERMS)],
    }
}

pub(super) fn report4(findings: &Findings) -> Report {
    let groups = findings.groups();
    let kinds: [(&str, Figure); 3] = [("marked", |r| r.marked), ("clean", |r| r.clean), ("noisy", |r| r.noisy)];
    let series = kinds.map(|(name, figure)| Series {
        name: format!("{name} clips"),
        points: (0u32..).zip(&groups).filter_map(|(i, g)| point(g, f64::from(i), figure, String::new())).collect(),
        joined: false,
    });
    Report {
        title: "Control clips (the paper's Table 4)".to_owned(),
        intro: "The paper's method with no control clips, with one kind, and with both. The message's bits in clips \
                without a mark should be at 50 %."
            .to_owned(),
        charts: vec![Chart {
            title: "the message's bits by kind of clip".to_owned(),
            x: Axis::of_names(groups.iter().map(|g| g.arm.to_owned()).collect()),
            y: Axis::linear("the message's bits, %"),
            series: series.to_vec(),
        }],
        tables: vec![with_printed(findings, "paper: marked / clean / noisy, %", &PRINTED_CONTROLS)],
    }
}
