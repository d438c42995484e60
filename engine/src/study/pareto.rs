//! Seconds against accuracy and fidelity: one setting changed at a time, and the front of what no other setting beats.

use std::sync::Arc;

use super::chart::{Axis, Chart, Series};
use super::fit;
use super::methods::{guard4d, point, with_bits};
use super::plan::{Arm, DEFAULT_BITS, Scale};
use super::report::Report;
use super::summary::{self, Column, Findings, Group};
use crate::clip::Precision;
use crate::render::OffsetBases;
use crate::watermark::embed::{EmbedConfig, LpipsTerm, Profile};
use crate::watermark::evidence::ExtractorMode;

/// The arm that the program takes unless told otherwise.
const DEFAULT: &str = "default";
/// Shares of the default's steps.
const STEPS: [(usize, usize); 4] = [(1, 4), (1, 2), (2, 1), (4, 1)];
/// Sides of training frames against the default's.
const SIDES: [(u32, u32); 2] = [(1, 2), (2, 1)];
/// Fidelities, dB.
const TARGETS: [f32; 4] = [36.0, 40.0, 46.0, 50.0];
/// Steps from one control of `joint` to the next.
const CONTROL_EVERY: [u32; 2] = [2, 4];
/// Bits of the message beside the default's.
const LENGTHS: [u32; 2] = [32, 48];

/// Steps from one comparison by LPIPS to the next, with a network for it.
const LPIPS_EVERY: [u32; 2] = [1, 4];
/// Share of the light that the splats with offsets carry, where not all have offsets.
const REACH: f32 = 0.9;
/// Power of its light in a splat's rate, where rates differ.
const VISIBILITY: f32 = 0.5;
/// Share of its neighbours in what a splat follows, where gradients are smoothed.
pub(super) const SMOOTH: f32 = 0.5;

/// The default, and every setting around it.
pub(super) fn arms(scale: &Scale) -> Vec<Arm> {
    let default = Arm::new(DEFAULT, scale.default_config());
    let with = |name: String, change: &dyn Fn(&mut EmbedConfig)| {
        let mut arm = Arm { name, ..default.clone() };
        change(&mut arm.config);
        arm
    };
    let joint = scale.config(Profile::Balanced, ExtractorMode::Joint);
    let mut arms = vec![
        default.clone(),
        Arm::new("extractor none", scale.config(Profile::Balanced, ExtractorMode::None)),
        Arm::new("extractor joint", joint.clone()),
        with("fit auto".to_owned(), &|config| *config = fit::auto(config.clone())),
        with("all SH bases".to_owned(), &|config| config.bases = OffsetBases::All),
        Arm { name: "half of the memory".to_owned(), is_tight: true, ..default.clone() },
        Arm { name: "16-bit weights".to_owned(), precision: Precision::Fixed16, ..default.clone() },
        with("constant rates".to_owned(), &|config| config.lr_floor = 1.0),
        with("cross-entropy instead of a margin".to_owned(), &|config| config.margin = 0.0),
        with(format!("splats with {REACH} of the light"), &|config| config.reach = REACH),
        with(format!("rates by light^{VISIBILITY}"), &|config| config.visibility = VISIBILITY),
        with("gradients smoothed over neighbours".to_owned(), &|config| config.smooth = SMOOTH),
        with("half of the clips".to_owned(), &|config| config.views = (config.views / 2).max(1)),
    ];
    let steps: &[(usize, usize)] = if scale.quick { &STEPS[..2] } else { &STEPS };
    arms.extend(steps.iter().map(|&(times, over)| {
        with(format!("steps x{times}/{over}"), &|config| config.steps = (config.steps * times / over).max(1))
    }));
    arms.extend(scale.lpips.iter().flat_map(|weights| {
        LPIPS_EVERY.map(|every| {
            let term = LpipsTerm { every, ..LpipsTerm::of_the_paper(Arc::clone(weights)) };
            with(format!("LPIPS every {every} steps"), &|config| config.lpips = Some(term.clone()))
        })
    }));
    if scale.quick {
        return arms;
    }
    arms.extend(TARGETS.map(|psnr| with(format!("{psnr} dB"), &|config| *config = config.clone().with_target(psnr))));
    arms.extend(SIDES.map(|(times, over)| {
        let side = scale.size_px * times / over;
        with(format!("{side} px"), &|config| config.size_px = (side, side))
    }));
    arms.extend(CONTROL_EVERY.map(|every| {
        let config = EmbedConfig { control_every: every, ..joint.clone() };
        Arm::new(format!("extractor joint, control every {every}"), config)
    }));
    arms.extend(LENGTHS.map(|bits| with_bits(Arm::new(format!("{bits} bits"), default.config.clone()), bits)));
    arms.push(Arm { name: "profile faithful".to_owned(), ..guard4d(scale, DEFAULT_BITS) });
    arms
}

/// Cost, accuracy and fidelity of an arm.
struct Standing {
    cpu_s: f64,
    marked: f64,
    psnr_db: f64,
}

impl Standing {
    fn of(group: &Group<'_>) -> Option<Self> {
        let marked = group.mean(|r| r.marked)?;
        Some(Self { cpu_s: group.mean(|r| r.cpu_s)?, marked, psnr_db: group.mean(|r| r.psnr_db)? })
    }

    /// Whether `other` is as good in all three, and better in one.
    fn is_beaten_by(&self, other: &Self) -> bool {
        let as_good = other.cpu_s <= self.cpu_s && other.marked >= self.marked && other.psnr_db >= self.psnr_db;
        as_good && (other.cpu_s < self.cpu_s || other.marked > self.marked || other.psnr_db > self.psnr_db)
    }
}

/// Names of the arms that none of the others beats.
fn front<'a>(groups: &[Group<'a>]) -> Vec<&'a str> {
    let all: Vec<_> = groups.iter().filter_map(|g| Some((g.arm, Standing::of(g)?))).collect();
    let kept = all.iter().filter(|(_, own)| !all.iter().any(|(_, other)| own.is_beaten_by(other)));
    kept.map(|(arm, _)| *arm).collect()
}

/// Whether an arm's evidence is an exact p-value, and its message as long as the default's.
fn is_comparable(group: &Group<'_>) -> bool {
    group.rows.iter().all(|row| row.p_value.is_some() && row.bits == DEFAULT_BITS)
}

const COLUMNS: [Column; 14] = [
    summary::ARM,
    summary::ROWS,
    summary::SECONDS,
    summary::CPU_SECONDS,
    summary::STEPS,
    ("offsets", |g| g.decimals(|r| r.offsets.map(|n| n as f64), 0)),
    summary::MARKED,
    summary::PSNR,
    summary::SSIM,
    summary::LPIPS,
    summary::CLEAN,
    summary::P_VALUE,
    summary::PEAK,
    summary::ERRORS,
];

pub(super) fn report(findings: &Findings) -> Report {
    let groups = findings.groups();
    let (sound, rest): (Vec<_>, Vec<_>) = findings.groups().into_iter().partition(is_comparable);
    let best = front(&sound);
    let series = |name: &str, groups: &[Group<'_>], keep: &dyn Fn(&str) -> bool, joined: bool| {
        let of = groups.iter().filter(|g| keep(g.arm));
        let mut points: Vec<_> =
            of.filter_map(|g| point(g, g.mean(|r| r.cpu_s)?, |r| r.marked, g.arm.to_owned())).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Series { name: name.to_owned(), points, joined }
    };
    let mut table = summary::table("Settings", NOTE, &COLUMNS, &groups);
    table.head.push("on the front".to_owned());
    for row in &mut table.rows {
        let is_best = row.first().is_some_and(|arm| best.contains(&arm.as_str()));
        row.push(if is_best { "yes" } else { "" }.to_owned());
    }
    Report {
        title: "Seconds against accuracy and fidelity".to_owned(),
        intro: "The default and one setting changed at a time, on the same scenes and seeds.".to_owned(),
        charts: vec![Chart {
            title: "bits right against CPU seconds of the embedding".to_owned(),
            x: Axis::logarithmic("CPU seconds"),
            y: Axis::linear("bits right, %"),
            series: vec![
                series("on the front", &sound, &|arm| best.contains(&arm), false),
                series("beaten", &sound, &|arm| !best.contains(&arm), false),
                series("no exact p-value, or other bits", &rest, &|_| true, false),
            ],
        }],
        tables: vec![table],
    }
}

const NOTE: &str = "On the front is what no other setting beats or equals in CPU seconds, bits right and PSNR together, among \
those with an exact p-value and messages of the default's length. A joint extractor may hold the message itself; its bits right are \
no evidence.";

#[cfg(test)]
mod tests {
    use super::super::row::Row;
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats() {
        let row = |cpu_s, marked, psnr| Row {
            cpu_s: Some(cpu_s),
            marked: Some(marked),
            psnr_db: Some(psnr),
            ..Row::default()
        };
        let rows = [row(10.0, 0.9, 43.0), row(20.0, 0.9, 43.0), row(20.0, 0.95, 43.0), row(30.0, 0.8, 50.0)];
        let names = ["fast", "slow for nothing", "better", "fainter"];
        let groups: Vec<_> =
            names.iter().zip(&rows).map(|(arm, row)| Group { arm, take: "plain", rows: vec![row] }).collect();
        assert_eq!(front(&groups), ["fast", "better", "fainter"], "all but the one that is only slower");
        let unmeasured = Row::default();
        let with_error = [Group { arm: "broken", take: "plain", rows: vec![&unmeasured] }];
        assert!(front(&with_error).is_empty(), "what has no figures beats nothing and is no best");
    }
}
