//! Runs of sub-studies: what is measured, in which order, and where reports go.

use std::path::{Path, PathBuf};

use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipSource;

use super::found::Found;
use super::lab::{Lab, OpenDevice};
use super::parts::{SUBSTUDIES, Substudy};
use super::plan::{Cell, Machine, Scale, Take};
use super::progress::{Step, Watcher};
use super::row::Row;
use super::scene::SceneSource;
use super::summary::Findings;
use crate::report::Origin;

/// The ledger's name in the folder of a study.
const LEDGER: &str = "readings.csv";

/// What a study is made with.
pub struct Study<'a> {
    /// Scenes, seeds and effort.
    pub scale: Scale,
    /// CLIP checkpoint.
    pub clip: ClipSource<'a>,
    /// Opens the device.
    pub open: OpenDevice<'a>,
    /// Folder for ledger, keys and reports; what is there is gone on with.
    pub out: PathBuf,
    /// How the study was called, for its reports.
    pub command: String,
}

impl Study<'_> {
    /// Measures what the ledger does not have and writes the reports; says where.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for scenes of the same name; when the device is lost; when outputs cannot be written; and
    /// what `watch` says.
    pub fn run(&self, what: &[Substudy], watch: Watcher<'_>) -> Result<Vec<PathBuf>, EngineError> {
        self.check()?;
        let mut ledger = Ledger::open(&self.out.join(LEDGER))?;
        let mut lab = Lab::open(self.open, self.clip.clone(), self.out.join("keys"), &self.scale.scenes)?;
        let mut written = Vec::new();
        for substudy in what {
            let cells = self.scale.cells(&(substudy.arms)(&self.scale));
            for (index, cell) in cells.iter().enumerate() {
                if is_measured(&ledger, cell, lab.machine()) {
                    continue;
                }
                watch(Step::Embedding { cell, index, len: cells.len() })?;
                ledger.append(lab.measure(cell, watch)?)?;
                // A study takes hours: what is there so far can be looked at.
                self.write(substudy, &cells, &ledger, lab.machine())?;
            }
            written.push(self.write(substudy, &cells, &ledger, lab.machine())?);
        }
        Ok(written)
    }

    fn check(&self) -> Result<(), EngineError> {
        let names: Vec<String> = self.scale.scenes.iter().map(SceneSource::to_string).collect();
        let twice = names.iter().enumerate().find(|(i, name)| names[..*i].contains(name));
        twice.map_or(Ok(()), |(_, name)| {
            Err(EngineError::Usage {
                what: "scenes".to_owned(),
                got: format!("two named {name}"),
                expected: "scenes whose files or folders have different names".to_owned(),
            })
        })
    }

    fn write(
        &self,
        substudy: &Substudy,
        cells: &[Cell],
        ledger: &Ledger<Row>,
        machine: &Machine,
    ) -> Result<PathBuf, EngineError> {
        let findings = Findings::gather(cells, ledger, machine);
        let rows = Found::to_csv(findings.rows())?;
        AtomicFile::write(&self.out.join(format!("{}.csv", substudy.name)), Existing::Replace, rows.as_bytes())?;
        write_report(substudy, &findings, &self.out, &self.command)
    }
}

/// What holds for every figure.
const RULES: &str = "Every figure is read from decoded 8-bit frames of views and times that training never saw; seeds \
differ in key, message, views, times and noise. A clip's bits come from its mean logits. Shares of bits in unmarked \
clips should be 50 %; in brackets how many embeddings keep to the two-sided 99 % band of as many coin flips (bits of \
one scene and key depend on one another, so chance leaves that band more often than that). Ranges are least and \
greatest over scenes and seeds. PSNR is of marked 8-bit frames against clean float renders, mean over views.";

/// Makes a report again from the rows that it left in the CSV file `rows`; nothing is measured. Says where the page is.
///
/// The file is what [`Study::run`] wrote as `NAME.csv`, or several of these together with a column `part` for their
/// names.
///
/// # Errors
/// [`EngineError::MissingInput`] and [`EngineError::BadData`] when the rows are not there or of another version; when
/// outputs cannot be written.
pub fn redraw(substudy: &Substudy, rows: &Path, out: &Path, command: &str) -> Result<PathBuf, EngineError> {
    let findings = Findings::of(Found::read_csv(rows, substudy.name)?);
    write_report(substudy, &findings, out, command)
}

/// Sub-studies that the CSV file `rows` has rows of; none where it holds something else. Without a column `part` it may
/// be any.
///
/// # Errors
/// [`EngineError::MissingInput`] and [`EngineError::BadData`] when it is not there or no table.
pub fn substudies_in(rows: &Path) -> Result<Vec<Substudy>, EngineError> {
    Found::parts_in(rows, SUBSTUDIES.to_vec(), |part| part.name)
}

fn write_report(substudy: &Substudy, findings: &Findings, out: &Path, command: &str) -> Result<PathBuf, EngineError> {
    let told = findings.rows().iter().map(|found| &found.row).filter(|row| !row.device.is_empty());
    let mut devices: Vec<String> = told.map(|row| format!("{}; version {}", row.device, row.version)).collect();
    devices.dedup();
    let readings = serde_json::to_value(findings.rows()).expect("numbers and words are valid JSON");
    (substudy.report)(findings).write(out, substudy.name, &Origin { command, rules: RULES, devices, readings })
}

/// Whether the ledger has all readings of a cell.
fn is_measured(ledger: &Ledger<Row>, cell: &Cell, machine: &Machine) -> bool {
    let id = cell.id(machine);
    cell.arm.takes.iter().all(|take| {
        let swapped = |row: &Row| *take != Take::Plain || !cell.arm.is_contested || row.swap_second.is_some();
        Row::newest(ledger, &id, &take.to_string()).is_some_and(|row| !row.error.is_empty() || swapped(row))
    })
}
