//! The tables that people read, made from the rows.

use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::fmt::Write;

use guard4d_engine::watermark::embed::StepPart;

use crate::ledger::{Ledger, Row};
use crate::row::{IDENTITY, part_column};

/// Rows that differ in nothing but the seed.
pub(crate) struct Group<'a> {
    ledger: &'a Ledger,
    rows: Vec<&'a Row>,
}

impl<'a> Group<'a> {
    /// The newest row of each case, by model, mode, settings and fidelity.
    pub(crate) fn all(ledger: &'a Ledger) -> Vec<Self> {
        let key =
            |row: &Row| ["clip", "model", "bits", "settings", "rescaled_db"].map(|c| ledger.cell(row, c).to_owned());
        let mut groups: Vec<Self> = Vec::new();
        for row in ledger.newest(&IDENTITY) {
            match groups.iter_mut().find(|g| key(g.rows[0]) == key(row)) {
                Some(group) => group.rows.push(row),
                None => groups.push(Self { ledger, rows: vec![row] }),
            }
        }
        groups.sort_by(|a, b| {
            let words = |g: &Self| ["model", "mode", "bits", "steps"].map(|c| g.cell(c).to_owned());
            let numbers = |g: &Self| ["target_db", "rescaled_db"].map(|c| g.ledger.number(g.rows[0], c).unwrap_or(0.0));
            words(a).cmp(&words(b)).then(numbers(a).partial_cmp(&numbers(b)).unwrap_or(Ordering::Equal))
        });
        groups
    }

    /// A cell that all rows share.
    pub(crate) fn cell(&self, column: &str) -> &'a str {
        self.ledger.cell(self.rows[0], column)
    }

    /// Values of a column, of the rows that have one.
    pub(crate) fn values(&self, column: &str) -> Vec<f64> {
        self.rows.iter().filter_map(|row| self.ledger.number(row, column)).collect()
    }

    /// Mean over the seeds.
    pub(crate) fn mean(&self, column: &str) -> Option<f64> {
        let values = self.values(column);
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }

    fn percent(&self, column: &str) -> String {
        self.mean(column).map(|v| format!("{:.1}", 100.0 * v)).unwrap_or_default()
    }

    /// Mean and range over the seeds.
    fn percent_range(&self, column: &str) -> String {
        let values = self.values(column);
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        format!("{} ({:.1}–{:.1})", self.percent(column), 100.0 * low, 100.0 * high)
    }

    fn decimals(&self, column: &str, digits: usize) -> String {
        self.mean(column).map(|v| format!("{v:.digits$}")).unwrap_or_default()
    }

    /// Mean, and in how many of the rows the control kept to chance.
    fn control(&self, column: &str) -> String {
        let flags: Vec<_> = self.rows.iter().map(|row| self.ledger.cell(row, &format!("{column}_in_band"))).collect();
        let all = flags.iter().filter(|flag| !flag.is_empty()).count();
        if all == 0 {
            return String::new();
        }
        format!("{} ({} of {all})", self.percent(column), flags.iter().filter(|flag| **flag == "yes").count())
    }

    /// The worst p-value, with its kind where it is not exact.
    fn worst_p(&self) -> String {
        let worst = self.values("p_value").into_iter().fold(0.0, f64::max);
        if self.cell("p_kind") == "exact" { format!("{worst:.1e}") } else { format!("none; bound {worst:.2}") }
    }

    fn present(&self) -> String {
        let present = self.rows.iter().filter(|row| self.ledger.cell(row, "verdict") == "present").count();
        format!("{present} of {}", self.rows.len())
    }

    /// Whether the mark is as the embedding left it.
    pub(crate) fn is_own(&self) -> bool {
        self.cell("rescaled_db").is_empty()
    }

    /// Model, mode and target.
    fn head(&self) -> String {
        let rescaled = if self.is_own() { String::new() } else { format!(" ×{}", self.decimals("strength", 2)) };
        format!("{} | {} | {}{rescaled}", self.cell("model"), self.cell("mode"), self.cell("target_db"))
    }
}

const NOTES: &str = "\
All figures come from 8-bit frames of the cameras in each model's `transforms_test.json`, which training never saw. \
A clip's bits come from its mean logits, before any threshold. Means over seeds; seeds differ in key, message, views \
and times. All shares are percentages.\n\n\
- **target**: the fidelity that was asked of the embedding. ×k: the same mark made k times as strong afterwards, \
which its extractor was not fitted to.\n\
- **PSNR, SSIM**: marked 8-bit frames against clean float renders, mean over frames; \"object\" counts pixels with less \
than half of the light from behind.\n\
- **marked** (range over seeds), **frames**: the message's bits in marked clips, and frame by frame.\n\
- **clean, noisy, other scenes**: the message's bits in clips of the unmarked model, in the same with noise, and in \
clips of the other models, which should be 50; in brackets how many seeds keep to the two-sided 99 % band of as many \
coin flips. Bits of one scene and key depend on one another, so chance leaves that band more often than that.\n\
- **worst p**: all marked frames as one reading; the chance that a random message matches as well. For `joint` there is \
no p-value, because it was trained with the message: only (1 + hits) / (1 + clips) from the other scenes.\n\
- **present**: in how many seeds `verify` would say so, controls included.\n\
- **wrong key**: the same extractor with another key. That key's own message should be at 50. The owner's message need \
not be: the calibration, which lies in the private extractor file, says which direction is which bit, so what is above \
50 here is what the extractor file alone gives away.\n\
- **untrained R**: `joint`'s copy read by its extractor before training, which is blind to the message: what the \
asset alone carries. (R replaced by the identity would be read through a calibration that was fitted through R.)\n\
- **swap**: a second copy with another message, optimised through the first copy's frozen extractor. The second \
message's bits are high if copies carry their messages; the first one's are then at 50, because both messages share \
half of their bits.\n";

/// `study.md`
pub(crate) fn markdown(ledger: &Ledger) -> String {
    let groups = Group::all(ledger);
    let rows: Vec<_> = groups.iter().flat_map(|g| &g.rows).collect();
    let distinct = |column: &str| {
        let cells: BTreeSet<_> = rows.iter().map(|row| ledger.cell(row, column)).collect();
        cells.into_iter().collect::<Vec<_>>().join("; ")
    };
    let mut out = format!(
        "# Accuracy against fidelity and cost\n\n\
         - Device: {}; driver: {}; host: {}\n\
         - Commit: {}; command: `./x study`; {} embeddings\n\
         - Bits: {}; frames: {}; steps: {}; CLIP: {}\n\n\
         ![accuracy against PSNR](study.svg)\n\n{NOTES}\n",
        distinct("device"),
        distinct("driver"),
        distinct("processor"),
        distinct("commit"),
        rows.len(),
        distinct("bits"),
        distinct("size_px"),
        distinct("steps"),
        distinct("clip"),
    );
    table(&mut out, "Accuracy", &groups, &ACCURACY);
    table(&mut out, "Where the message lives", &groups, &ORIGIN);
    out.push_str("## Cost\n\nWall-clock seconds; then the shares of a step's device time, in percent.\n\n");
    let own: Vec<_> = groups.into_iter().filter(|g| g.is_own() && g.mean("step_s").is_some()).collect();
    cost(&mut out, &own);
    out
}

type Column = (&'static str, fn(&Group<'_>) -> String);

const ACCURACY: [Column; 9] = [
    ("PSNR", |g| g.decimals("psnr_db", 2)),
    ("object", |g| g.decimals("object_psnr_db", 2)),
    ("SSIM", |g| g.decimals("ssim", 4)),
    ("marked", |g| g.percent_range("marked")),
    ("frames", |g| g.percent("marked_frames")),
    ("clean", |g| g.control("clean")),
    ("noisy", |g| g.control("noisy")),
    ("worst p", |g| g.worst_p()),
    ("present", |g| g.present()),
];

const ORIGIN: [Column; 6] = [
    ("other scenes", |g| g.control("other_scenes")),
    ("wrong key", |g| g.percent("wrong_key")),
    ("its own message", |g| g.percent("wrong_key_own")),
    ("untrained R", |g| g.percent("untrained")),
    ("swap: second message", |g| g.percent("swap_second")),
    ("swap: first message", |g| g.percent("swap_first")),
];

fn line(out: &mut String, cells: &str) {
    writeln!(out, "| {cells} |").expect("a string takes any text");
}

fn table(out: &mut String, title: &str, groups: &[Group<'_>], columns: &[Column]) {
    writeln!(out, "## {title}\n").expect("a string takes any text");
    let names: Vec<_> = columns.iter().map(|(name, _)| *name).collect();
    line(out, &format!("model | mode | target dB | seeds | {}", names.join(" | ")));
    line(out, &format!("--- | --- | ---: | ---: | {}", vec!["---:"; columns.len()].join(" | ")));
    for group in groups {
        let cells: Vec<_> = columns.iter().map(|(_, fill)| fill(group)).collect();
        line(out, &format!("{} | {} | {}", group.head(), group.rows.len(), cells.join(" | ")));
    }
    out.push('\n');
}

fn cost(out: &mut String, groups: &[Group<'_>]) {
    let parts: Vec<_> = StepPart::ALL.into_iter().filter(|p| *p != StepPart::Other).collect();
    let names: Vec<_> = parts.iter().map(|p| p.name().replace('_', " ")).collect();
    line(out, &format!("model | mode | target dB | plan | fit | train | per step | device ms | {}", names.join(" | ")));
    line(out, &format!("--- | --- {}", "| ---: ".repeat(6 + names.len()).trim_end()));
    for group in groups {
        let of = |part: StepPart| group.mean(&part_column(part)).unwrap_or(f64::NAN);
        let total: f64 = StepPart::ALL.into_iter().map(of).sum();
        let seconds = ["plan_s", "fit_s", "train_s"].map(|c| group.decimals(c, 1)).join(" | ");
        let shares: Vec<_> = parts.iter().map(|&p| format!("{:.1}", 100.0 * of(p) / total)).collect();
        let step = group.decimals("step_s", 3);
        line(out, &format!("{} | {seconds} | {step} | {total:.0} | {}", group.head(), shares.join(" | ")));
    }
}
