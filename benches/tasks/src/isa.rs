//! `./x isa`: what Mesa's compiler for AMD GPUs makes of every kernel, on a machine without such a GPU.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Args;
use serde_json::Value;

use crate::drivers::{found_by, radv_25};
use crate::error::{Error, Naming, Result};
use crate::process::output;
use crate::programs::executable;
use crate::workspace::{Workspace, say};

/// GPUs as Mesa names them: of GCN 5, RDNA 2 and RDNA 3.
const GPUS: [&str; 3] = ["vega10", "navi21", "gfx1100"];
/// Of RDNA 3 as Mesa 25 names it, whose compiler knows its cooperative matrices.
const GPU_WITH_MATRICES: &str = "navi31";
/// Columns of the table, and what the driver calls them.
const COLUMNS: [(&str, &str); 10] = [
    ("vgprs", "VGPRs"),
    ("sgprs", "SGPRs"),
    ("spilled_vgprs", "Spilled VGPRs"),
    ("spilled_sgprs", "Spilled SGPRs"),
    ("scratch_bytes", "Scratch size"),
    ("lds_bytes", "LDS size"),
    ("subgroups_per_simd", "Subgroups per SIMD"),
    ("instructions", "Instructions"),
    ("code_bytes", "Code size"),
    ("latency", "Latency"),
];
/// Those of a row that are compared: how many subgroups hide each other's waits, and how much there is to do.
const COMPARED: [&str; 2] = ["subgroups_per_simd", "instructions"];

/// Compile every kernel for AMD GPUs that need not be here, write one table, and compare it with the committed one;
/// spilled registers are a failure
#[derive(Args)]
pub(crate) struct IsaArgs {
    /// Replace the committed table
    #[arg(long)]
    renew: bool,
}

/// Numbers of a row by column.
type Row = BTreeMap<String, String>;
/// Rows by what was compiled.
type Table = BTreeMap<Program, Row>;

/// A kernel as one GPU has it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Program {
    gpu: String,
    kernel: String,
}

impl fmt::Display for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} on {}", self.kernel, self.gpu)
    }
}

/// Compiles, compares, and fails when registers spill.
pub(crate) fn run(workspace: &Workspace, args: &IsaArgs) -> Result<()> {
    workspace.need(&["compiler", "loader", "lavapipe"])?;
    let messages = ["--bin", "guard4d", "--message-format", "json-render-diagnostics"];
    let program = executable(&output(workspace.cargo("build").args(messages))?, "guard4d")?;
    let installed = found_by(&radv()?);
    let compilers = GPUS.map(|gpu| (gpu, installed.clone())).into_iter();
    let mut table = Table::new();
    for (gpu, environment) in compilers.chain([(GPU_WITH_MATRICES, radv_25(workspace)?)]) {
        let mut command = Command::new(&program);
        command.args(["--json", "lab", "isa"]).env("RADV_FORCE_FAMILY", gpu).envs(environment);
        take(gpu, &output(&mut command)?, &mut table)?;
    }
    if !table.keys().any(|program| program.kernel.ends_with("_coop")) {
        return Err(Error::Broken(format!("no kernel with cooperative matrices was compiled for {GPU_WITH_MATRICES}")));
    }
    let path = workspace.path("benches/results/isa/radv.csv");
    let known = fs::read_to_string(&path).map(|text| parsed(&text)).unwrap_or_default();
    let changes = changes(&known, &table);
    changes.iter().for_each(|change| println!("{change}"));
    say(&format!("{} programs, {} changed", table.len(), changes.len()));
    if args.renew {
        fs::write(&path, text(&table)).of_file(&path)?;
        say(&path.display().to_string());
    }
    let spilled: Vec<String> =
        table.iter().filter(|(_, row)| spills(row)).map(|(program, _)| program.to_string()).collect();
    if spilled.is_empty() { Ok(()) } else { Err(Error::Broken(format!("spilled registers: {}", spilled.join(", ")))) }
}

/// The manifest of Mesa's driver for AMD GPUs, which Debian packs with the others.
fn radv() -> Result<PathBuf> {
    let folder = Path::new("/usr/share/vulkan/icd.d");
    let entries = fs::read_dir(folder).of_file(folder)?;
    let mut found: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    found.retain(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("radeon_icd")));
    found.sort();
    found.into_iter().next().ok_or_else(|| Error::Missing("RADV, Mesa's driver for AMD GPUs, is not installed".into()))
}

/// Adds what one GPU's compiler said.
fn take(gpu: &str, told: &str, table: &mut Table) -> Result<()> {
    let bad = || Error::Broken(format!("`guard4d lab isa` told nothing of {gpu}"));
    let told: Value = serde_json::from_str(told).map_err(|_| bad())?;
    for (kernel, numbers) in told["programs"].as_object().ok_or_else(bad)? {
        let number = |name: &str| numbers[name].as_f64().map_or_else(String::new, |number| number.to_string());
        let row = COLUMNS.iter().map(|(column, name)| ((*column).to_owned(), number(name))).collect();
        table.insert(Program { gpu: gpu.to_owned(), kernel: kernel.clone() }, row);
    }
    Ok(())
}

fn text(table: &Table) -> String {
    let mut text = format!("gpu,kernel,{}\n", COLUMNS.map(|(column, _)| column).join(","));
    for (Program { gpu, kernel }, row) in table {
        let _ = writeln!(text, "{gpu},{kernel},{}", COLUMNS.map(|(column, _)| row[column].as_str()).join(","));
    }
    text
}

fn parsed(text: &str) -> Table {
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let row = |line: &str| {
        let cells: Row =
            head.iter().zip(line.split(',')).map(|(name, cell)| ((*name).to_owned(), cell.into())).collect();
        Some((Program { gpu: cells.get("gpu")?.clone(), kernel: cells.get("kernel")?.clone() }, cells))
    };
    lines.filter_map(row).collect()
}

/// What became of programs since the committed table, in words.
fn changes(known: &Table, now: &Table) -> Vec<String> {
    let new = now.iter().filter_map(|(program, row)| {
        let Some(before) = known.get(program) else { return Some(format!("{program}: new")) };
        let told: Vec<String> = COMPARED
            .into_iter()
            .filter(|column| before.get(*column) != row.get(*column))
            .map(|column| format!("{column} {} -> {}", before.get(column).map_or("", String::as_str), row[column]))
            .collect();
        (!told.is_empty()).then(|| format!("{program}: {}", told.join(", ")))
    });
    let gone = known.keys().filter(|program| !now.contains_key(program)).map(|program| format!("{program}: gone"));
    new.chain(gone).collect()
}

fn spills(row: &Row) -> bool {
    ["spilled_vgprs", "spilled_sgprs"].iter().any(|column| row[*column].parse().is_ok_and(|count: f64| count > 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(instructions: u32, spilled: u32) -> Table {
        let numbers = format!("{{\"Instructions\": {instructions}, \"Spilled VGPRs\": {spilled}, \"VGPRs\": 24}}");
        let mut table = Table::new();
        take("navi21", &format!("{{\"programs\": {{\"nn/axpy_fwd\": {numbers}}}}}"), &mut table).expect("a table");
        table
    }

    #[test]
    fn a_table_is_read_as_it_was_written_and_changes_are_told() {
        let before = told(100, 0);
        let read = parsed(&text(&before));
        assert!(changes(&read, &before).is_empty(), "nothing changed");
        assert_eq!(changes(&read, &told(120, 0)), ["nn/axpy_fwd on navi21: instructions 100 -> 120"]);
        assert_eq!(changes(&Table::new(), &before), ["nn/axpy_fwd on navi21: new"]);
        assert_eq!(changes(&read, &Table::new()), ["nn/axpy_fwd on navi21: gone"]);
        assert!(take("navi21", "{}", &mut Table::new()).is_err(), "a driver that tells nothing is no driver");
    }

    #[test]
    fn spilled_registers_are_seen() {
        assert!(!told(100, 0).values().any(spills), "none");
        assert!(told(100, 3).values().all(spills), "three");
    }
}
