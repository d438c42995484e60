//! What a processor under lavapipe has to reach, and whether this run did.

use std::fmt::Write;

/// Figure of a row that a target is about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Figure {
    /// Percent of the FMA peak of one core, by CPU time.
    FmaShare,
    /// CPU time in ms.
    CoreMs,
    /// Time in ms of one part of so many.
    MsEach(f64),
    /// CPU time in ns of one part of so many.
    CoreNsEach(f64),
    /// Exponent of the CPU time over a range of sizes.
    Exponent,
}

/// Which side of a bound is good: the floor that must be reached, and the stretch goal beyond it.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Bound {
    AtLeast(f64, Option<f64>),
    AtMost(f64, Option<f64>),
}

/// One line of the table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    pub(crate) what: &'static str,
    /// Beginning of the name of its row, or the axis of a fit.
    pub(crate) row: &'static str,
    pub(crate) figure: Figure,
    pub(crate) bound: Bound,
}

const fn target(what: &'static str, row: &'static str, figure: Figure, bound: Bound) -> Target {
    Target { what, row, figure, bound }
}

const GEMM: Bound = Bound::AtLeast(30.0, Some(38.0));
const GEMM_16: Bound = Bound::AtLeast(34.0, Some(42.0));
const LINEAR: Bound = Bound::AtMost(1.05, None);
/// Images of the CLIP rows.
const IMAGES: f64 = 8.0;
/// Keys of the sorting row by its passes of eight bits.
const KEY_PASSES: f64 = 4.0 * 1_048_576.0;

/// The floors and stretch goals for processors.
pub(crate) const TARGETS: [Target; 19] = [
    target("GEMM f32, N768 K768", "nn/matmul 400x768x768", Figure::FmaShare, GEMM),
    target("GEMM f32, N2304 K768", "nn/matmul 400x768x2304", Figure::FmaShare, GEMM),
    target("GEMM f32, N3072 K768", "nn/matmul 400x768x3072", Figure::FmaShare, GEMM),
    target("GEMM f32, N768 K3072", "nn/matmul 400x3072x768", Figure::FmaShare, GEMM),
    target("GEMM, 16-bit weights, N768 K768", "nn/matmul 400x768x768, 16", Figure::FmaShare, GEMM_16),
    target("GEMM, 16-bit weights, N2304 K768", "nn/matmul 400x768x2304, 16", Figure::FmaShare, GEMM_16),
    target("GEMM, 16-bit weights, N3072 K768", "nn/matmul 400x768x3072, 16", Figure::FmaShare, GEMM_16),
    target("GEMM, 16-bit weights, N768 K3072", "nn/matmul 400x3072x768, 16", Figure::FmaShare, GEMM_16),
    target("blend 50k, 800²", "splat/rasterize forward 50k, 800", Figure::CoreMs, Bound::AtMost(25.0, Some(17.0))),
    target("blend 50k, 400²", "splat/rasterize forward 50k, 400", Figure::CoreMs, Bound::AtMost(16.0, Some(11.0))),
    target("dL/dcolour, 400²", "splat/rasterize backward 50k, 400", Figure::CoreMs, Bound::AtMost(20.0, Some(14.0))),
    target("conv 16->16, 224²", "nn/conv3d forward 16->16, 8x224", Figure::FmaShare, Bound::AtLeast(24.0, Some(31.0))),
    target("conv 3->16, 224²", "nn/conv3d forward 3->16, 8x224", Figure::FmaShare, Bound::AtLeast(13.0, Some(17.0))),
    target(
        "CLIP ViT-B/32 forward, one image of 8",
        "clip/ViT-B/32 forward 8",
        Figure::MsEach(IMAGES),
        Bound::AtMost(160.0, Some(120.0)),
    ),
    target(
        "CLIP ViT-B/32 forward and back to the input, one image of 8",
        "clip/ViT-B/32 forward and backward 8",
        Figure::MsEach(IMAGES),
        Bound::AtMost(340.0, None),
    ),
    target(
        "radix sort, one key in one pass",
        "scan/radix_sort 1 Mi",
        Figure::CoreNsEach(KEY_PASSES),
        Bound::AtMost(13.0, Some(9.0)),
    ),
    target("cost over views", "V", Figure::Exponent, LINEAR),
    target("cost over frames", "F", Figure::Exponent, LINEAR),
    target("cost over splats", "N", Figure::Exponent, LINEAR),
];

impl Figure {
    fn unit(self) -> &'static str {
        match self {
            Self::FmaShare => " % of the FMA peak",
            Self::CoreMs => " core-ms",
            Self::MsEach(_) => " ms",
            Self::CoreNsEach(_) => " core-ns",
            Self::Exponent => "",
        }
    }
}

impl Bound {
    /// Whether `value` reaches `limit`; a NaN reaches nothing.
    fn holds(self, value: f64, limit: f64) -> bool {
        match self {
            Self::AtLeast(..) => value >= limit,
            Self::AtMost(..) => value <= limit,
        }
    }

    fn floor(self) -> f64 {
        match self {
            Self::AtLeast(floor, _) | Self::AtMost(floor, _) => floor,
        }
    }

    fn stretch(self) -> Option<f64> {
        match self {
            Self::AtLeast(_, stretch) | Self::AtMost(_, stretch) => stretch,
        }
    }

    /// Verdict on a value that may not have been measured.
    pub(crate) fn verdict(self, value: Option<f64>) -> &'static str {
        let Some(value) = value else { return "not measured" };
        match self.stretch() {
            Some(stretch) if self.holds(value, stretch) => "met, with the stretch",
            _ if self.holds(value, self.floor()) => "met",
            _ => "**not met**",
        }
    }

    fn sign(self) -> &'static str {
        match self {
            Self::AtLeast(..) => "≥",
            Self::AtMost(..) => "≤",
        }
    }
}

/// A target's figure in one run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Measured {
    pub(crate) median: f64,
    /// Of the fastest sample; the floors were set by such figures.
    pub(crate) best: f64,
}

/// The table of all targets; `measured` gives a target's figure if the run has it.
pub(crate) fn table(measured: impl Fn(&Target) -> Option<Measured>) -> String {
    let mut out = "| target | row | floor | stretch | median | best | best meets it | median meets it |\n\
                   | --- | --- | ---: | ---: | ---: | ---: | --- | --- |\n"
        .to_owned();
    for target in TARGETS {
        let (sign, unit) = (target.bound.sign(), target.figure.unit());
        let limit = |limit: f64| format!("{sign} {limit}{unit}");
        let stretch = target.bound.stretch().map(limit).unwrap_or_default();
        let value = measured(&target);
        let [median, best] = [value.map(|v| v.median), value.map(|v| v.best)];
        let figure = |v: Option<f64>| v.map(|v| format!("{v:.2}{unit}")).unwrap_or_default();
        let cells = [figure(median), figure(best)].join(" | ");
        let verdicts = [best, median].map(|v| target.bound.verdict(v)).join(" | ");
        let (what, row, floor) = (target.what, target.row, limit(target.bound.floor()));
        writeln!(out, "| {what} | {row} | {floor} | {stretch} | {cells} | {verdicts} |")
            .expect("a string takes any text");
    }
    out
}
