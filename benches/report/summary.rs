//! A table for machines, one for people, and a chart.

use std::fmt::Write;
use std::path::PathBuf;

use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::watermark::step_part::StepPart;

use super::chart::{self, Bars};
use super::compare::{CORE_MS, JUDGED_BY, MS, NAME, QUARTILES};
use super::figures::peak;
use super::host::{commit, date, load, processor, results};
use super::stats::exponent;
use super::target::{self, Figure, Measured, Target};
use crate::harness::{Bench, MemoryRow, Outcome, Row, SAMPLES, Work};
use crate::kernels::probe::{ARITHMETIC, HOST, MEMORY};
use crate::pipeline::memory::{BUDGET, CLIPS, STEPS};

/// What of a run its rows do not say.
pub(crate) struct Run {
    /// The command line that makes the same rows again.
    pub(crate) command: String,
    /// Load of the machine before the first row.
    pub(crate) load: String,
    /// Where the report goes, if not to a folder that is named after day and device.
    pub(crate) out: Option<PathBuf>,
}

/// Writes `results.csv`, `summary.md` and `shares.svg`. A part of the rows is only written where the command line says.
pub(crate) fn write(bench: &Bench, run: &Run) -> Outcome {
    let folder: PathBuf = match &run.out {
        Some(folder) => folder.clone(),
        None if bench.is_partial() || bench.rows.is_empty() => {
            println!("{}{}", rows(bench), memory(bench));
            eprintln!("only a part was measured: no report is written without --out");
            return Ok(());
        }
        None => results(&bench.device),
    };
    for (file, text) in
        [("results.csv", csv(bench)), ("summary.md", summary(bench, run)), ("shares.svg", shares_chart(bench))]
    {
        let path = folder.join(file);
        AtomicFile::write(&path, Existing::Replace, text.as_bytes())?;
        eprintln!("{}", path.display());
    }
    Ok(())
}

/// Percent of a row's limits; `None` where there is no limit or the clock says nothing about the device.
struct Shares {
    /// Of the device's peak, by its clock.
    device: Option<f64>,
    /// Of the same peak, both by CPU time.
    core: Option<f64>,
    /// Of the FMA peak of one core, by CPU time.
    fma: Option<f64>,
    /// The same of the fastest runs of both.
    best_fma: Option<f64>,
}

impl Shares {
    fn of(bench: &Bench, row: &Row) -> Self {
        let share = |rate: fn(&Row) -> Option<f64>, limit: &str| {
            rate(row).zip(peak(bench, limit, rate)).map(|(rate, peak)| 100.0 * rate / peak)
        };
        let limit = match row.work {
            Work::Flops(..) => Some(ARITHMETIC),
            Work::Bytes(..) => Some(MEMORY),
            Work::Mixed => None,
        }
        // The device has no part in that row.
        .filter(|_| row.name != HOST);
        let computes = bench.is_cpu() && matches!(row.work, Work::Flops(..));
        Self {
            device: limit.and_then(|limit| share(Row::rate, limit)),
            core: limit.filter(|_| bench.is_cpu()).and_then(|limit| share(Row::core_rate, limit)),
            fma: if computes { share(Row::core_rate, HOST) } else { None },
            best_fma: if computes { share(Row::best_core_rate, HOST) } else { None },
        }
    }
}

/// A number with so many decimals, nothing if there is none.
fn cell(value: Option<f64>, decimals: usize) -> String {
    value.map(|v| format!("{v:.decimals$}")).unwrap_or_default()
}

/// Unit of a row's rate in billions, and the formula of its work.
fn unit(row: &Row) -> (&'static str, &'static str) {
    match row.work {
        Work::Flops(_, formula) => ("GFLOP/s", formula),
        Work::Bytes(_, formula) => ("GB/s", formula),
        Work::Mixed => ("", ""),
    }
}

fn giga(rate: Option<f64>) -> Option<f64> {
    rate.map(|r| r * 1e-9)
}

fn csv(bench: &Bench) -> String {
    let times = [MS, CORE_MS].map(|clock| QUARTILES.map(|end| format!("{clock}{end}")).join(","));
    let mut out = format!(
        "{NAME},{},samples,{JUDGED_BY},rate,core_rate,unit,share_percent,core_share_percent,\
         fma_share_percent,best_ms,best_core_ms,best_fma_share_percent,work\n",
        times.join(",")
    );
    let judged_by = if bench.is_cpu() { CORE_MS } else { MS };
    for row in &bench.rows {
        let times = [row.time(), row.core_time()]
            .map(|q| [q.low, q.median, q.high].map(|seconds| format!("{:.5}", seconds * 1e3)).join(","));
        let Shares { device, core, fma, best_fma } = Shares::of(bench, row);
        let [best_ms, best_core_ms] = [row.best_seconds(), row.best_core_seconds()].map(|s| format!("{:.5}", s * 1e3));
        let best = [best_ms, best_core_ms, cell(best_fma, 2)].join(",");
        let shares = [device, core, fma].map(|share| cell(share, 2)).join(",");
        let rates = [row.rate(), row.core_rate()].map(|rate| cell(giga(rate), 3)).join(",");
        let (unit, formula) = unit(row);
        let (name, samples) = (&row.name, row.seconds.len());
        let times = times.join(",");
        writeln!(out, "\"{name}\",{times},{samples},{judged_by},{rates},{unit},{shares},{best},\"{formula}\"")
            .expect("a string takes any text");
    }
    out
}

fn summary(bench: &Bench, run: &Run) -> String {
    let mut out = head(bench, run);
    out.push_str(&targets(bench));
    out.push_str(&rows(bench));
    out.push_str(&stages(bench));
    out.push_str(&fits(bench));
    out.push_str(&memory(bench));
    out.push_str(&split(bench));
    let missing = bench.unmeasured();
    if !missing.is_empty() {
        writeln!(out, "\n**No row runs these kernels**: {}", missing.join(", ")).expect("a string takes any text");
    }
    out
}

/// The machine, the source, and what the figures mean.
fn head(bench: &Bench, run: &Run) -> String {
    let info = bench.device.info();
    let layers = if bench.device.is_validated() { "on: wall-clock rows are too slow" } else { "off" };
    let peak = |limit, rate: fn(&Row) -> Option<f64>| {
        giga(peak(bench, limit, rate)).map_or_else(|| "unknown".to_owned(), |p| format!("{p:.1}"))
    };
    format!(
        "# Benchmarks, {}\n\n\
         - Device: {}; driver: {}; kernels: {}; host: {}\n\
         - Commit: {}; command: `{}`; validation layers {layers}\n\
         - Load average over 1 and 5 minutes: {} before, {} after\n\
         - Peaks of this run on the device: {} GFLOP/s multiply and add in registers, {} GB/s memory (the better of a \
         device copy and a kernel of three streams); by CPU time {} GFLOP/s and {} GB/s per core\n\
         - Peak of one core in this process: {} GFLOP/s fused multiply and add in 256-bit registers, by CPU time\n\
         - Device memory: at most {:.0} MiB in buffers, {:.0} MiB taken from the driver\n\n\
         Times are medians of at least {SAMPLES} runs; quartiles are in `results.csv`. \"ms\" is device time \
         (timestamps around every pass, compilation excluded), but wall clock where the name says so. \"core-ms\" is \
         CPU time of this process over all threads, recording and waiting included: on a device that is this processor \
         the figure that other jobs disturb least, on any other what the host spends. Shares compare useful work, \
         counted by the formula, with the peak of the same run; data that stays in a cache can pass 100 %. \
         `shares.svg` \
         shows them.\n",
        date(),
        info.name,
        info.driver,
        bench.device.family(),
        processor(),
        commit(),
        run.command,
        run.load,
        load(),
        peak(ARITHMETIC, Row::rate),
        peak(MEMORY, Row::rate),
        peak(ARITHMETIC, Row::core_rate),
        peak(MEMORY, Row::core_rate),
        peak(HOST, Row::core_rate),
        mib(bench.device.memory_use().peak_bytes),
        mib(bench.device.memory_use().peak_reserved_bytes),
    )
}

/// Figure of a target in this run.
fn measured(bench: &Bench, target: &Target) -> Option<Measured> {
    let both = |[median, best]: [Option<f64>; 2]| Some(Measured { median: median?, best: best? });
    if target.figure == Figure::Exponent {
        let times: [fn(&Row) -> f64; 2] = [|row| row.core_time().median, Row::best_core_seconds];
        return both(times.map(|time| fitted(bench, target.row, time)));
    }
    let row = bench.rows.iter().find(|row| row.name.starts_with(target.row))?;
    let seconds = [row.time().median, row.best_seconds()];
    let core_seconds = [row.core_time().median, row.best_core_seconds()];
    both(match target.figure {
        Figure::FmaShare => {
            let Shares { fma, best_fma, .. } = Shares::of(bench, row);
            [fma, best_fma]
        }
        Figure::CoreMs => core_seconds.map(|s| Some(s * 1e3)),
        Figure::MsEach(parts) => seconds.map(|s| Some(s * 1e3 / parts)),
        Figure::CoreNsEach(parts) => core_seconds.map(|s| Some(s * 1e9 / parts)),
        Figure::Exponent => [None, None],
    })
}

fn targets(bench: &Bench) -> String {
    if !bench.is_cpu() {
        return "\n## Targets\n\nThey are about processors, and this device is none.\n".to_owned();
    }
    let table = target::table(|target| measured(bench, target));
    format!(
        "\n## Targets\n\nFor processors; a row that `--full` alone measures is \"not measured\" without it. \
         The floors come from the fastest of 7 to 25 runs by CPU time; on a shared machine the median also says how \
         busy its neighbours were.\
         \n\n{table}"
    )
}

fn rows(bench: &Bench) -> String {
    let mut out = "\n## Rows\n\n\
                   | what | ms | core-ms | best | rate | share of peak | by CPU time | of core's FMA peak | \
                   best | work |\n\
                   | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |\n"
        .to_owned();
    for row in &bench.rows {
        let Shares { device, core, fma, best_fma } = Shares::of(bench, row);
        let percent = |share: Option<f64>| share.map(|s| format!("{s:.1} %")).unwrap_or_default();
        let shares = [device, core, fma, best_fma].map(percent).join(" | ");
        let (unit, formula) = unit(row);
        let (ms, core_ms) = (row.time().median * 1e3, row.core_time().median * 1e3);
        let best = row.best_core_seconds() * 1e3;
        let rate = cell(giga(row.rate()), 2);
        writeln!(out, "| {} | {ms:.3} | {core_ms:.3} | {best:.3} | {rate} {unit} | {shares} | {formula} |", row.name)
            .expect("a string takes any text");
    }
    out
}

/// Parts of an embedding step: device time, and what is left of the clock on the wall.
fn stages(bench: &Bench) -> String {
    let steps: Vec<_> = bench.rows.iter().filter(|row| !row.stages.is_empty()).collect();
    if steps.is_empty() {
        return String::new();
    }
    let names = StepPart::ALL.map(StepPart::name).join(" | ");
    let mut out = format!(
        "\n## Stages of an embedding step\n\nMean ms of device time; \"rest\" is what is left of the mean by the \
         clock on the wall.\n\n| row | {names} | rest |\n| --- |{}\n",
        " ---: |".repeat(StepPart::ALL.len() + 1)
    );
    for row in steps {
        let whole = row.seconds.iter().sum::<f64>() / row.seconds.len() as f64;
        let part = |seconds: f64| format!("{:.2} ({:.0} %)", seconds * 1e3, 100.0 * seconds / whole);
        let parts = StepPart::ALL.map(|stage| part(row.stages.get(&stage).copied().unwrap_or(0.0))).join(" | ");
        let rest = part(whole - row.stages.values().sum::<f64>());
        writeln!(out, "| {} | {parts} | {rest} |", row.name).expect("a string takes any text");
    }
    out
}

/// Sizes and times of the rows of one axis.
fn points(bench: &Bench, axis: &str, time: impl Fn(&Row) -> f64) -> Vec<(f64, f64)> {
    let on_axis = |row: &Row| row.scale.filter(|s| s.axis == axis).map(|s| (s.size, time(row)));
    bench.rows.iter().filter_map(on_axis).collect()
}

fn fitted(bench: &Bench, axis: &str, time: impl Fn(&Row) -> f64) -> Option<f64> {
    exponent(&points(bench, axis, time))
}

/// Exponents of the cost over each axis.
fn fits(bench: &Bench) -> String {
    let mut out = String::new();
    for (axis, what) in [("V", "views"), ("F", "frames"), ("N", "splats")] {
        let sizes: Vec<f64> = points(bench, axis, |_| 1.0).into_iter().map(|(size, _)| size).collect();
        let (Some(first), Some(last)) = (sizes.first(), sizes.last()) else { continue };
        let [core, wall] = [fitted(bench, axis, |r| r.core_time().median), fitted(bench, axis, |r| r.time().median)];
        let [core, wall] = [core, wall].map(|power| cell(power, 3));
        let factor = last / first;
        writeln!(out, "| {what}, {axis} | {first} to {last}, {factor}x | {core} | {wall} |").expect("a string");
    }
    if out.is_empty() {
        return out;
    }
    format!(
        "\n## Scaling\n\nTime of planning, rendering and differentiating as size to a power: least squares between \
         logarithms. What does not grow makes it smaller than 1.\n\n\
         | over | range | power of CPU time | of time by the clock |\n| --- | --- | ---: | ---: |\n{out}"
    )
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

/// What embeddings of large scenes took.
fn memory(bench: &Bench) -> String {
    if bench.memory.is_empty() {
        return String::new();
    }
    let mut out = format!(
        "\n## Memory\n\nEmbeddings within {:.0} MiB of device memory, {STEPS} steps on {CLIPS} clips of \
         8 frames; splats are copies of the demo scene's. The peaks of what is taken from the driver and \
         of what buffers hold may come at different times.\n\n\
         | what | MiB taken | MiB in buffers | taken to held | plan s | fit s | s per step |\n\
         | --- | ---: | ---: | ---: | ---: | ---: | ---: |\n",
        mib(BUDGET)
    );
    for MemoryRow { name, used, seconds: [plan, fit, step] } in &bench.memory {
        let [taken, held] = [used.peak_reserved_bytes, used.peak_bytes].map(mib);
        let ratio = taken / held;
        writeln!(out, "| {name} | {taken:.0} | {held:.0} | {ratio:.3} | {plan:.1} | {fit:.1} | {step:.2} |")
            .expect("a string takes any text");
    }
    out
}

/// Where the time of rows with several kernels goes.
fn split(bench: &Bench) -> String {
    let mut out = "\n## By kernel\n\nMeans over the runs of rows that run several kernels.\n\n\
                   | row | kernel | ms | share |\n| --- | --- | ---: | ---: |\n"
        .to_owned();
    for row in bench.rows.iter().filter(|row| row.split.len() > 1) {
        let total: f64 = row.split.values().sum();
        for (kernel, seconds) in &row.split {
            let share = if total > 0.0 { 100.0 * seconds / total } else { 0.0 };
            writeln!(out, "| {} | {kernel} | {:.3} | {share:.1} % |", row.name, seconds * 1e3)
                .expect("a string takes any text");
        }
    }
    out
}

/// `shares.svg`
fn shares_chart(bench: &Bench) -> String {
    let bars = |row: &Row| {
        let Shares { device, fma, .. } = Shares::of(bench, row);
        (device.is_some() || fma.is_some()).then(|| Bars { name: row.name.clone(), shares: [device, fma] })
    };
    let legend = [
        "share of the device's peak in this run: arithmetic in registers, or memory",
        "share of the FMA peak of one core, by CPU time",
    ];
    chart::svg(legend, &bench.rows.iter().filter_map(bars).collect::<Vec<_>>())
}
