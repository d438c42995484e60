//! No more than a scene needs: stopping by held-out clips against taking all steps.

use guard4d_engine::release::gate::Gate;
use guard4d_engine::watermark::embed::EmbedConfig;

use super::methods::point;
use crate::chart::{Axis, Chart, Series};
use crate::report::Report;
use crate::study::plan::{Arm, DEFAULT_BITS, Scale};
use crate::study::row::Row;
use crate::study::summary::{self, Column, Findings};
use crate::table::Table;

/// Name of the arm that takes all steps.
const FULL: &str = "fit full";
/// Name of the arm that stops.
const AUTO: &str = "fit auto";

/// Settings that stop as `embed --fit auto` does: at what its quality gate asks for.
pub(super) fn auto(config: EmbedConfig) -> EmbedConfig {
    let bits = DEFAULT_BITS as usize;
    config.adaptive(Gate::for_bits(bits).aim(), bits)
}

/// Both, with the default's settings.
pub(super) fn arms(scale: &Scale) -> Vec<Arm> {
    let full = scale.default_config();
    vec![Arm::new(AUTO, auto(full.clone())), Arm::new(FULL, full)]
}

const COLUMNS: [Column; 11] = [
    summary::ARM,
    summary::ROWS,
    summary::STEPS,
    ("offsets", |g| g.decimals(|r| r.offsets.map(|n| n as f64), 0)),
    summary::SECONDS,
    summary::CPU_SECONDS,
    summary::MARKED,
    summary::PROVEN,
    summary::PSNR,
    summary::PRESENT,
    summary::ERRORS,
];

pub(super) fn report(findings: &Findings) -> Report {
    let scenes = findings.scenes();
    let curve = |arm: &str| {
        let of = |scene: &str| {
            let group = findings.groups_where(|row| row.scene == scene).into_iter().find(|g| g.arm == arm)?;
            point(&group, group.mean(|r| r.cpu_s)?, |r| r.marked, scene.to_owned())
        };
        Series { name: arm.to_owned(), points: scenes.iter().filter_map(|scene| of(scene)).collect(), joined: false }
    };
    let mut tables: Vec<Table> = vec![by_scene(findings)];
    tables.extend(scenes.iter().map(|&scene| {
        summary::table(scene, "Means over seeds.", &COLUMNS, &findings.groups_where(|row| row.scene == scene))
    }));
    Report {
        title: "No more than a scene needs".to_owned(),
        intro: "The default settings with all their steps, and stopped when held-out clips say that the mark is \
                good enough."
            .to_owned(),
        charts: vec![Chart {
            title: "bits right against CPU seconds, by scene".to_owned(),
            x: Axis::logarithmic("CPU seconds"),
            y: Axis::linear("bits right, %"),
            series: [AUTO, FULL].map(curve).to_vec(),
        }],
        tables,
    }
}

/// Whether stopping cost the proof: all clips together prove the message of the full mark, but not of the one that
/// stopped.
fn is_too_early(auto: &Row, full: &Row) -> bool {
    full.is_read() && !auto.is_read()
}

/// What stopping saves and costs, scene by scene.
fn by_scene(findings: &Findings) -> Table {
    let line = |&scene: &&str| {
        let groups = findings.groups_where(|row| row.scene == scene);
        let of = |arm: &str| groups.iter().find(|g| g.arm == arm);
        let (auto, full) = (of(AUTO)?, of(FULL)?);
        let ratio = |figure: summary::Figure| Some(format!("{:.2}", auto.mean(figure)? / full.mean(figure)?));
        let pairs = auto.rows.iter().filter_map(|a| Some((*a, *full.rows.iter().find(|f| f.seed == a.seed)?)));
        let wrong = pairs.clone().filter(|(a, f)| is_too_early(a, f));
        Some(vec![
            scene.to_owned(),
            ratio(|r| r.cpu_s)?,
            ratio(|r| r.steps.map(|s| s as f64))?,
            ratio(|r| r.offsets.map(|n| n as f64))?,
            auto.percent_range(|r| r.marked),
            full.percent_range(|r| r.marked),
            auto.percent(|r| r.proven),
            full.percent(|r| r.proven),
            format!("{} of {}", wrong.count(), pairs.count()),
        ])
    };
    Table {
        title: "Auto against full".to_owned(),
        note: "Ratios of means over seeds. Too early: by `verify`'s test and rate, all clips together prove the \
               message of the full mark of the same seed, and not of this one."
            .to_owned(),
        head: [
            "scene",
            "CPU seconds",
            "steps",
            "offsets",
            "bits right, auto, %",
            "bits right, full, %",
            "clips that prove it alone, auto, %",
            "clips that prove it alone, full, %",
            "too early",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows: findings.scenes().iter().filter_map(line).collect(),
    }
}
