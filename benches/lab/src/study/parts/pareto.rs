//! Seconds against accuracy and fidelity: one setting changed at a time, and the front of what no other setting beats.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::watermark::embed::{EmbedConfig, LpipsTerm, Profile};
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::shape::OffsetBases;

use super::fit;
use super::methods::{guard4d, point, with_bits};
use crate::chart::{Axis, Chart, Series};
use crate::report::Report;
use crate::study::plan::{Arm, DEFAULT_BITS, Scale, Take};
use crate::study::summary::{self, Column, Findings, Group};

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
/// Frames of every clip that the default's mark is read from again.
const FRAMES: [usize; 3] = [1, 2, 4];
/// Largest offsets against the default's.
const MAX_OFFSETS: [f32; 2] = [0.5, 2.0];
/// Bits of the message beside the default's.
const LENGTHS: [u32; 2] = [32, 48];

/// Steps from one comparison by LPIPS to the next, with a network for it.
const LPIPS_EVERY: [u32; 2] = [1, 4];
/// Logit beyond which a bit is left alone, where there is one.
const MARGIN: f32 = 6.0;
/// Share of the light that the splats with offsets carry, where not all have offsets.
const VISIBILITY_SHARE: f32 = 0.9;

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
        Arm { takes: std::iter::once(Take::Plain).chain(FRAMES.map(Take::Frames)).collect(), ..default.clone() },
        Arm::new("extractor none", scale.config(Profile::Balanced, ExtractorMode::None)),
        Arm::new("extractor pretrained", scale.config(Profile::Balanced, ExtractorMode::Pretrained)),
        Arm::new("extractor joint", joint.clone()),
        with("fit auto".to_owned(), &|config| *config = fit::auto(config.clone())),
        with("DC alone".to_owned(), &|config| config.fidelity.bases = OffsetBases::Dc),
        Arm { name: "half of the memory".to_owned(), is_tight: true, ..default.clone() },
        Arm { name: "16-bit weights".to_owned(), precision: Precision::Fixed16, ..default.clone() },
        with("constant rates".to_owned(), &|config| config.optimiser.lr_floor = 1.0),
        with(format!("a margin of {MARGIN} instead of cross-entropy"), &|config| config.objective.margin = MARGIN),
        with(format!("splats with {VISIBILITY_SHARE} of the light"), &|config| {
            config.fidelity.visibility_share = VISIBILITY_SHARE
        }),
        with("offsets without a bound".to_owned(), &|config| config.fidelity.max_offset = None),
        with("calibration without copies".to_owned(), &|config| {
            config.extractor.calibration_mut().into_iter().for_each(|c| c.copies.clear())
        }),
        with("half of the clips".to_owned(), &|config| config.views.clips = (config.views.clips / 2).max(1)),
    ];
    let steps: &[(usize, usize)] = if scale.quick { &STEPS[..2] } else { &STEPS };
    arms.extend(steps.iter().map(|&(times, over)| {
        with(format!("steps x{times}/{over}"), &|config| {
            config.optimiser.steps = (config.optimiser.steps * times / over).max(1)
        })
    }));
    arms.extend(scale.lpips.iter().flat_map(|network| {
        LPIPS_EVERY.map(|every| {
            let term = LpipsTerm { every, ..LpipsTerm::of_the_paper(network.clone()) };
            with(format!("LPIPS every {every} steps"), &|config| config.objective.lpips = Some(term.clone()))
        })
    }));
    if scale.quick {
        return arms;
    }
    arms.extend(MAX_OFFSETS.map(|times| {
        let bound = default.config.fidelity.max_offset.map(|bound| times * bound);
        with(format!("largest offset x{times}"), &|config| config.fidelity.max_offset = bound)
    }));
    arms.extend(TARGETS.map(|psnr| with(format!("{psnr} dB"), &|config| *config = config.clone().with_target(psnr))));
    arms.extend(SIDES.map(|(times, over)| {
        let side = scale.size_px * times / over;
        with(format!("{side} px"), &|config| config.views.size_px = (side, side))
    }));
    arms.extend(CONTROL_EVERY.map(|every| {
        let config = joint.clone().with(|c| c.extractor.joint_mut().into_iter().for_each(|j| j.control_every = every));
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

/// Scenes and seeds that every arm was measured on: others would favour the arms that have them, or lack them.
fn shared<'a>(groups: &[Group<'a>]) -> Vec<(&'a str, u64)> {
    let of = |group: &Group<'a>| -> Vec<_> {
        let measured = group.rows.iter().filter(|row| row.marked.is_some());
        measured.map(|row| (row.scene.as_str(), row.seed)).collect()
    };
    let all: Vec<_> = groups.iter().map(of).filter(|cells| !cells.is_empty()).collect();
    let Some((first, rest)) = all.split_first() else { return Vec::new() };
    first.iter().filter(|cell| rest.iter().all(|cells| cells.contains(cell))).copied().collect()
}

/// Mean and standard error, in points, of the bits right beyond those of `default` on the same scenes and seeds.
fn gain_over(default: &Group<'_>, group: &Group<'_>) -> Option<(f64, Option<f64>)> {
    let gains: Vec<f64> = group
        .rows
        .iter()
        .filter_map(|row| {
            let base = default.rows.iter().find(|base| base.scene == row.scene && base.seed == row.seed)?;
            Some(100.0 * (row.marked? - base.marked?))
        })
        .collect();
    let n = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / n;
    let squares: f64 = gains.iter().map(|gain| (gain - mean).powi(2)).sum();
    (!gains.is_empty()).then(|| (mean, (gains.len() > 1).then(|| (squares / (n - 1.0) / n).sqrt())))
}

/// Labels of the groups that none of the others beats.
fn front(groups: &[Group<'_>]) -> Vec<String> {
    let all: Vec<_> = groups.iter().filter_map(|g| Some((label(g), Standing::of(g)?))).collect();
    let kept = all.iter().filter(|(_, own)| !all.iter().any(|(_, other)| own.is_beaten_by(other)));
    kept.map(|(label, _)| label.clone()).collect()
}

/// Whether an arm's evidence is an exact p-value, and its message as long as the default's.
fn is_comparable(group: &Group<'_>) -> bool {
    group.rows.iter().all(|row| row.p_value.is_some() && row.bits == DEFAULT_BITS)
}

/// What a group is called in the chart.
fn label(group: &Group<'_>) -> String {
    if group.take == Take::Plain.to_string() { group.arm.to_owned() } else { format!("{}, {}", group.arm, group.take) }
}

const COLUMNS: [Column; 18] = [
    summary::ARM,
    summary::TAKE,
    summary::ROWS,
    summary::SECONDS,
    summary::CPU_SECONDS,
    summary::STEPS,
    ("offsets", |g| g.decimals(|r| r.offsets.map(|n| n as f64), 0)),
    summary::MARKED,
    summary::PROVEN,
    summary::PSNR,
    summary::COLOUR,
    summary::COLOUR_P95,
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
    let shared = shared(&sound);
    let fair = findings.groups_where(|row| shared.contains(&(row.scene.as_str(), row.seed)));
    let best = front(&fair.into_iter().filter(is_comparable).collect::<Vec<_>>());
    let series = |name: &str, groups: &[Group<'_>], keep: &dyn Fn(&String) -> bool, joined: bool| {
        let of = groups.iter().filter(|g| keep(&label(g)));
        let mut points: Vec<_> = of.filter_map(|g| point(g, g.mean(|r| r.cpu_s)?, |r| r.marked, label(g))).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Series { name: name.to_owned(), points, joined }
    };
    let note = format!("{NOTE} It is drawn by {} scenes and seeds that all of these were measured on.", shared.len());
    let mut table = summary::table("Settings", &note, &COLUMNS, &groups);
    table.head.extend(["bits right beyond the default's, points", "on the front"].map(str::to_owned));
    let default = groups.iter().find(|group| group.arm == DEFAULT);
    for (row, group) in table.rows.iter_mut().zip(&groups) {
        row.push(match default.and_then(|default| gain_over(default, group)) {
            Some((gain, Some(error))) => format!("{gain:+.1} ± {error:.1}"),
            Some((gain, None)) => format!("{gain:+.1}"),
            None => String::new(),
        });
        row.push(if best.contains(&label(group)) { "yes" } else { "" }.to_owned());
    }
    Report {
        title: "Seconds against accuracy and fidelity".to_owned(),
        intro: "The default and one setting changed at a time, on the same scenes and seeds.".to_owned(),
        charts: vec![Chart {
            title: "bits right against CPU seconds of the embedding".to_owned(),
            x: Axis::logarithmic("CPU seconds"),
            y: Axis::linear("bits right, %"),
            series: vec![
                series("on the front", &sound, &|label| best.contains(label), false),
                series("beaten", &sound, &|label| !best.contains(label), false),
                series("no exact p-value, or other bits", &rest, &|_| true, false),
            ],
        }],
        tables: vec![table],
    }
}

const NOTE: &str = "On the front is what no other setting beats or equals in CPU seconds, bits right and PSNR \
together, among those with an exact p-value and messages of the default's length. Beyond the default's: mean over \
scenes and seeds that both have, with its standard error. A joint extractor may hold the message itself; its bits \
right are no evidence.";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::row::Row;

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
        assert!(shared(&groups) == [("", 0)], "all rows are of one scene and seed");
        let unmeasured = Row::default();
        let with_error = [Group { arm: "broken", take: "plain", rows: vec![&unmeasured] }];
        assert!(front(&with_error).is_empty(), "what has no figures beats nothing and is no best");
    }

    #[test]
    fn arms_are_compared_where_all_were_measured() {
        let row = |seed: u64, marked: Option<f64>| Row { scene: "robot".to_owned(), seed, marked, ..Row::default() };
        let [a, b, c] = [(0, 0.5), (1, 0.7), (2, 0.9)].map(|(seed, marked)| row(seed, Some(marked)));
        let [x, y, failed] = [row(1, Some(0.8)), row(2, Some(0.9)), row(0, None)];
        let group = |arm, rows| Group { arm, take: "plain", rows };
        let (default, other) = (group(DEFAULT, vec![&a, &b, &c]), group("other", vec![&x, &y, &failed]));
        let never = group("never measured", vec![&failed]);
        let (gain, error) = gain_over(&default, &other).expect("two seeds of both");
        // Gains of 10 and 0 points: a mean of 5, and a standard deviation of 7.07 over the root of two.
        assert!((gain - 5.0).abs() < 1e-9 && error.is_some_and(|e| (e - 5.0).abs() < 1e-9), "{gain} {error:?}");
        assert!(gain_over(&default, &never).is_none(), "nothing to compare");
        assert_eq!(shared(&[default, other, never]), [("robot", 1), ("robot", 2)], "what failed everywhere counts not");
    }
}
