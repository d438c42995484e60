//! Where methods fail: scenes, films and settings far from the usual.

use super::methods::{point, with_bits};
use crate::chart::{Axis, Chart, Series};
use crate::report::Report;
use crate::study::found::Found;
use crate::study::plan::{Arm, Scale, Take};
use crate::study::row::Row;
use crate::study::scene::Variant;
use crate::study::summary::{self, Column, Findings, Group};
use crate::table::Table;

/// Scenes that are hard in one way each.
const VARIANTS: [Variant; 12] = [
    Variant::Still,
    Variant::Motion(4.0),
    Variant::Motion(16.0),
    Variant::Splats(200),
    Variant::Splats(2000),
    Variant::Splats(200_000),
    Variant::Textureless,
    Variant::White,
    Variant::Black,
    Variant::Opacity(0.3),
    Variant::Opacity(0.1),
    Variant::Opacity(0.02),
];
/// Those of a first look.
const QUICK_VARIANTS: [Variant; 6] = [
    Variant::Motion(16.0),
    Variant::Splats(200),
    Variant::Textureless,
    Variant::White,
    Variant::Black,
    Variant::Opacity(0.1),
];
/// Message lengths up to what no checkpoint of CLIP's kind holds.
const LENGTHS: [u32; 7] = [8, 32, 48, 64, 72, 96, 128];
/// Sides of training frames, pixels.
const SIDES: [(u32, u32); 6] = [(112, 112), (224, 224), (540, 540), (1080, 1080), (480, 270), (270, 480)];

/// Films of the usual mark that are farther off than training.
const TAKES: [Take; 17] = [
    Take::Plain,
    Take::Frames(1),
    Take::Frames(2),
    Take::Frames(4),
    Take::Elevation(-30.0),
    Take::Elevation(0.0),
    Take::Elevation(75.0),
    Take::Elevation(88.0),
    Take::Distance(0.6),
    Take::Distance(1.5),
    Take::Distance(2.5),
    Take::Times(0.0, 0.2),
    Take::Times(0.8, 1.0),
    Take::Size(112, 112),
    Take::Size(640, 360),
    Take::Size(360, 640),
    Take::Size(1080, 1080),
];

/// The usual mark in all films, then every hard scene, length and size in the usual film.
pub(super) fn arms(scale: &Scale) -> Vec<Arm> {
    let usual = Arm { takes: TAKES.to_vec(), ..Arm::new("usual", scale.default_config()) };
    let one = Arm { takes: vec![Take::Plain], ..usual.clone() };
    let variants: &[Variant] = if scale.quick { &QUICK_VARIANTS } else { &VARIANTS };
    let lengths: &[u32] = if scale.quick { &LENGTHS[2..6] } else { &LENGTHS };
    let sides: &[(u32, u32)] = if scale.quick { &[] } else { &SIDES };
    let varied = variants.iter().map(|v| Arm { name: v.to_string(), variant: *v, ..one.clone() });
    let lengthened = lengths.iter().map(|&bits| with_bits(Arm { name: format!("{bits} bits"), ..one.clone() }, bits));
    let sized = sides.iter().map(|&(width, height)| {
        let mut arm = Arm { name: format!("trained at {width}x{height} px"), ..one.clone() };
        arm.config.views.size_px = (width, height);
        arm
    });
    std::iter::once(usual.clone()).chain(varied).chain(lengthened).chain(sized).collect()
}

/// What is known of why a row fails.
fn cause(row: &Row, usual: Option<f64>) -> String {
    if !row.error.is_empty() {
        return row.error.clone();
    }
    let mut causes = Vec::new();
    if row.offsets == Some(0) {
        causes.push("no offset has any effect".to_owned());
    }
    if row.psnr_db.is_some_and(|psnr| psnr > f64::from(row.target_db) + FAINT_DB) {
        let psnr = row.psnr_db.unwrap_or_default();
        causes.push(format!("the mark stays faint: {psnr:.1} dB where {} may be spent", row.target_db));
    }
    if row.clean_in_band == Some(false) {
        causes.push("bits of unmarked clips are biased".to_owned());
    }
    if row.frames.zip(row.marked).is_some_and(|(frames, marked)| frames > marked) {
        causes.push("frames of a clip do not agree".to_owned());
    }
    if usual.is_some_and(|usual| row.marked.is_some_and(|marked| marked >= usual - NEAR)) {
        causes.push("no worse than the usual scene, which this setting does not carry far enough".to_owned());
    }
    if causes.is_empty() {
        causes.push("the mark is there at the fidelity asked for, and is read too faintly".to_owned());
    }
    causes.join("; ")
}

/// A mark so much above the target fidelity was held back by something else.
const FAINT_DB: f64 = 3.0;
/// Shares of bits that differ by less are alike: one bit of 16 in half of six clips.
const NEAR: f64 = 0.03;

const COLUMNS: [Column; 13] = [
    summary::ARM,
    summary::TAKE,
    summary::ROWS,
    summary::MARKED,
    summary::FRAMES,
    summary::PROVEN,
    summary::CLEAN,
    summary::NOISY,
    summary::PSNR,
    summary::P_VALUE,
    summary::PRESENT,
    summary::CPU_SECONDS,
    summary::ERRORS,
];

pub(super) fn report(findings: &Findings) -> Report {
    let groups = findings.groups();
    let usual = groups.iter().find(|g| g.arm == "usual" && g.take == "plain").and_then(|g| g.mean(|r| r.marked));
    let name = |g: &Group<'_>| if g.take == "plain" { g.arm.to_owned() } else { g.take.to_owned() };
    let points = (0u32..).zip(&groups).filter_map(|(i, g)| point(g, f64::from(i), |r| r.marked, String::new()));
    let series =
        vec![Series { name: "bits right, mean and range".to_owned(), points: points.collect(), joined: false }];
    Report {
        title: "Where methods fail".to_owned(),
        intro: "The default settings on scenes, films, message lengths and sizes that are far from the usual. What \
                fails is listed seed by seed with what is known of the cause."
            .to_owned(),
        charts: vec![Chart {
            title: "bits right".to_owned(),
            x: Axis::of_names(groups.iter().map(name).collect()),
            y: Axis::linear("bits right, %"),
            series,
        }],
        tables: vec![
            summary::table("All conditions", "Means over scenes and seeds.", &COLUMNS, &groups),
            failures(findings, usual),
        ],
    }
}

/// Every row that `verify` could not accept.
fn failures(findings: &Findings, usual: Option<f64>) -> Table {
    let failed = findings.rows().iter().filter(|found| !found.row.is_read());
    let line = |found: &Found| {
        let row = &found.row;
        let percent = row.marked.map(|m| format!("{:.1}", 100.0 * m)).unwrap_or_default();
        vec![found.arm.clone(), row.take.clone(), row.scene.clone(), row.seed.to_string(), percent, cause(row, usual)]
    };
    Table {
        title: "Failures".to_owned(),
        note: "Readings whose clips, all together, do not prove the message by `verify`'s test at its rate.".to_owned(),
        head: ["arm", "film", "scene", "seed", "bits right, %", "cause"].map(str::to_owned).to_vec(),
        rows: failed.map(line).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_have_causes() {
        let row = Row {
            bits: 16,
            target_db: 43.0,
            marked: Some(0.6),
            p_soft: Some(2e-3),
            psnr_db: Some(49.0),
            ..Row::default()
        };
        assert!(!row.is_read(), "too much like chance for 16 bits");
        assert!(cause(&row, Some(0.95)).contains("faint: 49.0 dB"), "{}", cause(&row, Some(0.95)));
        assert!(cause(&row, Some(0.6)).contains("no worse than the usual"), "a bad seed, not a bad scene");
        let refused = Row { error: "too long".to_owned(), ..Row::default() };
        assert_eq!((refused.is_read(), cause(&refused, None)), (false, "too long".to_owned()), "its own words");
        assert!(Row { bits: 16, p_soft: Some(1e-3), ..Row::default() }.is_read(), "the rate itself");
    }
}
