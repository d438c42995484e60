//! The table that a run leaves behind.

use std::fmt::Write;

use guard4d_engine::output::{AtomicFile, Existing};

use crate::Outcome;
use crate::harness::{Bench, Row, SAMPLES, Work};
use crate::host::{commit, date, load, processor, results};
use crate::probe::{ARITHMETIC, MEMORY};

/// Writes `results.csv` and `summary.md`, unless the command line asked for a part only.
pub(crate) fn write(bench: &Bench) -> Outcome {
    if bench.partial > 0 || bench.rows.is_empty() {
        eprintln!("only a part was measured: no report is written");
        return Ok(());
    }
    let folder = results(&bench.device);
    for (file, text) in [("results.csv", csv(bench)), ("summary.md", summary(bench))] {
        let path = folder.join(file);
        AtomicFile::write(&path, Existing::Replace, text.as_bytes())?;
        eprintln!("{}", path.display());
    }
    Ok(())
}

/// Rate in giga-units, its unit, the share of the peak and the formula of a row.
fn columns(bench: &Bench, row: &Row) -> [String; 4] {
    let (unit, peak, formula) = match row.work {
        Work::Flops(_, formula) => ("GFLOP/s", bench.peak(ARITHMETIC), formula),
        Work::Bytes(_, formula) => ("GB/s", bench.peak(MEMORY), formula),
        Work::Mixed => ("", None, ""),
    };
    let rate = row.rate().map(|r| format!("{:.2}", r * 1e-9)).unwrap_or_default();
    let share = row.rate().zip(peak).map(|(r, p)| format!("{:.1}", 100.0 * r / p)).unwrap_or_default();
    [rate, unit.to_owned(), share, formula.to_owned()]
}

fn csv(bench: &Bench) -> String {
    let mut out = "name,median_ms,samples,rate,unit,share_of_peak_percent,work\n".to_owned();
    for row in &bench.rows {
        let cells = columns(bench, row).map(|c| format!("\"{c}\"")).join(",");
        writeln!(out, "\"{}\",{:.4},{},{cells}", row.name, row.median() * 1e3, row.samples.len())
            .expect("a string takes any text");
    }
    out
}

fn summary(bench: &Bench) -> String {
    let info = bench.device.info();
    let (date, commit) = (date(), commit());
    let layers = if bench.device.is_validated() { "on: wall-clock rows are too slow" } else { "off" };
    let peak = |prefix| bench.peak(prefix).map_or(0.0, |p| p * 1e-9);
    let mut out = format!(
        "# Benchmarks, {date}\n\n\
         - Device: {}; driver: {}; host: {}\n\
         - Commit: {commit}; command: `./x bench`; validation layers {layers}\n\
         - Load average over 1 and 5 minutes: {} before, {} after\n\
         - Peaks of this run: {:.1} GFLOP/s multiply and add in registers, {:.1} GB/s memory (the better of a device \
         copy and a kernel of three streams)\n\n\
         Times are medians of at least {SAMPLES} runs in device time (timestamps around every pass, compilation \
         excluded), but wall clock where the name says so. Shares compare useful work, counted by the formula, with \
         the peak of the same run; data that stays in a cache can pass 100 %.\n\n\
         | what | ms | rate | share of peak | work |\n| --- | ---: | ---: | ---: | --- |\n",
        info.name,
        info.driver,
        processor(),
        bench.load,
        load(),
        peak(ARITHMETIC),
        peak(MEMORY),
    );
    for row in &bench.rows {
        let [rate, unit, share, formula] = columns(bench, row);
        let share = if share.is_empty() { share } else { format!("{share} %") };
        writeln!(out, "| {} | {:.3} | {rate} {unit} | {share} | {formula} |", row.name, row.median() * 1e3)
            .expect("a string takes any text");
    }
    out.push_str(&split(bench));
    let missing = bench.unmeasured();
    if !missing.is_empty() {
        writeln!(out, "\n**No row runs these kernels**: {}", missing.join(", ")).expect("a string takes any text");
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
