//! The paper's Tables 1 and 2: methods and message lengths, with its figures beside ours.

use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::watermark::embed::Profile;

use crate::chart::{Axis, Chart, Point, Series};
use crate::report::Report;
use crate::study::plan::{Arm, DEFAULT_BITS, Scale};
use crate::study::summary::{self, Column, Figure, Findings, Group};
use crate::table::Table;

/// Guard4D as printed, at its message length.
pub(super) const PAPER_ARM: &str = "Guard4D, 16 bits";

/// A line that the paper prints: bit accuracy in percent, PSNR in dB, SSIM and LPIPS, on D-NeRF and on HyperNeRF.
struct Printed {
    arm: &'static str,
    d_nerf: [f64; 4],
    hyper_nerf: [f64; 4],
}

/// Guard4D, Tables 1 and 2: eight frames of 100 views, 8 and 4 scenes, ViT-B/32.
const PRINTED: [Printed; 5] = [
    Printed {
        arm: "GuardSplat, one frame",
        d_nerf: [88.64, 41.17, 0.9958, 0.0036],
        hyper_nerf: [97.75, 42.97, 0.9973, 0.0032],
    },
    Printed {
        arm: "multi-frame baseline",
        d_nerf: [89.38, 42.75, 0.9969, 0.0011],
        hyper_nerf: [76.55, 46.37, 0.9984, 0.0013],
    },
    Printed { arm: PAPER_ARM, d_nerf: [99.81, 49.87, 0.9992, 0.0002], hyper_nerf: [96.83, 54.19, 0.9995, 0.0003] },
    Printed {
        arm: "Guard4D, 32 bits",
        d_nerf: [94.26, 48.28, 0.9987, 0.0004],
        hyper_nerf: [86.17, 50.49, 0.9989, 0.0008],
    },
    Printed {
        arm: "Guard4D, 48 bits",
        d_nerf: [89.95, 46.98, 0.9988, 0.0005],
        hyper_nerf: [86.77, 50.72, 0.9991, 0.0008],
    },
];

/// Message lengths beside the paper's.
const LENGTHS: [u32; 7] = [8, 16, 32, 48, 64, 96, 128];
/// Those of a first look.
const QUICK_LENGTHS: [u32; 3] = [16, 32, 48];

/// An arm with another message length, whose calibration has a random field per bit at least.
pub(super) fn with_bits(mut arm: Arm, bits: u32) -> Arm {
    arm.bits = bits;
    let probes = arm.config.extractor.probes().max(bits as usize);
    arm.config = arm.config.with_probes(probes);
    arm
}

/// The paper's method.
pub(super) fn guard4d(scale: &Scale, bits: u32) -> Arm {
    let arm = Arm::new(format!("Guard4D, {bits} bits"), scale.config(Profile::Faithful, ExtractorMode::Joint));
    with_bits(arm, bits)
}

/// The paper's methods and this program's own.
pub(super) fn table1(scale: &Scale) -> Vec<Arm> {
    let baseline = |name: &str, profile: Profile| Arm::new(name, scale.config(profile, profile.default_mode()));
    let own = |mode: ExtractorMode| Arm::new(format!("this program, {mode}"), scale.config(Profile::Balanced, mode));
    vec![
        baseline("GuardSplat, one frame", Profile::Guardsplat),
        baseline("multi-frame baseline", Profile::MultiFrame),
        guard4d(scale, DEFAULT_BITS),
        own(ExtractorMode::None),
        own(ExtractorMode::Blind),
        own(ExtractorMode::Pretrained),
        own(ExtractorMode::Joint),
    ]
}

pub(super) fn report1(findings: &Findings) -> Report {
    Report {
        title: "Methods (the paper's Table 1)".to_owned(),
        intro: "The paper's baselines and its method by its printed objective, and this program's own settings, \
                which hold the fidelity at 43 dB, with its four extractors. The paper used ViT-B/32 and other \
                scenes; compare the order, not the digits."
            .to_owned(),
        charts: vec![against_psnr("bits right against PSNR", findings)],
        tables: tables(findings),
    }
}

/// Message lengths with the fidelities in dB that marks of the paper's extractor are held to besides, for accuracies of
/// 99, 94 and 90 % at 44, 43 and 42 dB: half a decibel more than that.
const HELD: [(u32, f32); 3] = [(16, 44.5), (32, 43.5), (48, 42.5)];

/// Message lengths of the paper's method, as printed and with the fidelity held, and of the default.
pub(super) fn table2(scale: &Scale) -> Vec<Arm> {
    let lengths: &[u32] = if scale.quick { &QUICK_LENGTHS } else { &LENGTHS };
    let own = |&bits| with_bits(Arm::new(format!("default, {bits} bits"), scale.default_config()), bits);
    let held = HELD.map(|(bits, psnr)| {
        let config = scale.config(Profile::Balanced, ExtractorMode::Joint).with_target(psnr);
        with_bits(Arm::new(format!("joint held at {psnr} dB, {bits} bits"), config), bits)
    });
    lengths.iter().map(|&bits| guard4d(scale, bits)).chain(held).chain(lengths.iter().map(own)).collect()
}

pub(super) fn report2(findings: &Findings) -> Report {
    let curve = |start: &str, name: &str| {
        let of = findings.groups();
        let points = of.iter().filter(|g| g.arm.starts_with(start)).filter_map(|g| {
            let bits = f64::from(g.rows.first()?.bits);
            point(g, bits, |r| r.marked, String::new())
        });
        Series { name: name.to_owned(), points: points.collect(), joined: true }
    };
    let printed = PRINTED.iter().filter(|line| line.arm.starts_with("Guard4D")).map(|line| {
        let bits = line.arm.split([' ', ',']).find_map(|word| word.parse().ok()).unwrap_or(f64::NAN);
        Point { x: bits, y: line.d_nerf[0], range: (line.d_nerf[0], line.d_nerf[0]), label: String::new() }
    });
    let paper = Series { name: "the paper, D-NeRF".to_owned(), points: printed.collect(), joined: true };
    Report {
        title: "Message lengths (the paper's Table 2)".to_owned(),
        intro: "The paper's method by its printed objective, the same extractor with the fidelity held instead, and \
                this program's default, with messages of 8 to 128 bits. A checkpoint whose text tower has fewer \
                positions than a message needs refuses it (the built-in one ends at 72 bits)."
            .to_owned(),
        charts: vec![Chart {
            title: "bits right against message length".to_owned(),
            x: Axis::logarithmic("bits"),
            y: Axis::linear("bits right, %"),
            series: vec![
                curve("Guard4D", "Guard4D, the paper's objective"),
                curve("joint", "joint, fidelity held"),
                curve("default", "default"),
                paper,
            ],
        }],
        tables: tables(findings),
    }
}

const COLUMNS: [Column; 18] = [
    summary::ARM,
    summary::ROWS,
    summary::MARKED,
    summary::EXACT,
    summary::PSNR,
    summary::OBJECT,
    summary::COLOUR,
    summary::COLOUR_P95,
    summary::SSIM,
    summary::LPIPS,
    summary::CLEAN,
    summary::NOISY,
    summary::P_VALUE,
    summary::P_MATCHES,
    summary::PRESENT,
    summary::SECONDS,
    summary::CPU_SECONDS,
    summary::ERRORS,
];

/// All scenes together with the paper's lines, then scene by scene.
fn tables(findings: &Findings) -> Vec<Table> {
    let mut first = summary::table("All scenes", "Means over scenes and seeds.", &COLUMNS, &findings.groups());
    for (name, place) in [("paper: bits right, % (D-NeRF / HyperNeRF)", 0), ("paper: PSNR, dB", 1)] {
        first.head.push(name.to_owned());
        for row in &mut first.rows {
            let printed = PRINTED.iter().find(|line| row.first().is_some_and(|arm| arm == line.arm));
            row.push(printed.map(|l| format!("{} / {}", l.d_nerf[place], l.hyper_nerf[place])).unwrap_or_default());
        }
    }
    let scene = |&scene: &&str| summary::table(scene, "", &COLUMNS, &findings.groups_where(|row| row.scene == scene));
    std::iter::once(first).chain(findings.scenes().iter().map(scene)).collect()
}

/// The mean of a share in percent, over `x`.
pub(super) fn point(group: &Group<'_>, x: f64, figure: Figure, label: String) -> Option<Point> {
    let [mean, least, most] = group.spread(figure)?.map(|v| 100.0 * v);
    Some(Point { x, y: mean, range: (least, most), label })
}

/// Each arm at its fidelity, beside what the paper prints of it.
pub(super) fn against_psnr(title: &str, findings: &Findings) -> Chart {
    let (mut series, mut printed) = (Vec::new(), Vec::new());
    for group in findings.groups() {
        let Some(psnr) = group.mean(|r| r.psnr_db) else { continue };
        let points = point(&group, psnr, |r| r.marked, String::new()).into_iter().collect();
        series.push(Series { name: group.arm.to_owned(), points, joined: false });
        if let Some(line) = PRINTED.iter().find(|line| line.arm == group.arm) {
            let [bits, psnr, ..] = line.d_nerf;
            printed.push(Point { x: psnr, y: bits, range: (bits, bits), label: line.arm.to_owned() });
        }
    }
    series.push(Series { name: "the paper, D-NeRF".to_owned(), points: printed, joined: false });
    let (x, y) = (Axis::linear("PSNR, dB"), Axis::linear("bits right, %"));
    Chart { title: title.to_owned(), x, y, series }
}
