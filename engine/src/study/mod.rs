//! Studies: how well marks are read, against what they cost, and where that fails.
//!
//! A sub-study is a list of arms; every arm is embedded in every scene with every seed, and read from decoded 8-bit frames of
//! views and times that training never saw. Rows go into one ledger as soon as they are measured, so that a run that is
//! broken off goes on where it was and embeddings that several sub-studies need are made once. Tables and charts are made
//! from the ledger.

mod ablation;
mod attacks;
mod chart;
mod extractors;
mod fit;
mod general;
mod lab;
mod ledger;
mod methods;
mod pareto;
mod plan;
mod report;
mod row;
mod scene;
mod stability;
mod summary;
pub mod svg;
mod table;

use std::path::{Path, PathBuf};

use serde::Serialize;

pub use chart::{Axis, Chart, Point, Series};
pub use lab::OpenDevice;
pub use ledger::Ledger;
pub use plan::{Arm, Cell, Machine, Scale, Take};
pub use report::Report;
pub use row::Row;
pub use scene::{SceneSource, Variant};
pub use table::Table;

use crate::clip::ClipSource;
use crate::error::EngineError;
use lab::Lab;
use summary::Findings;

/// The ledger's name in the folder of a study.
const LEDGER: &str = "readings.csv";

/// What is studied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Substudy {
    /// The paper's Table 1: methods.
    Table1,
    /// The paper's Table 2: message lengths.
    Table2,
    /// The paper's Table 3: terms of the loss.
    Table3,
    /// The paper's Table 4: control clips.
    Table4,
    /// Where the message lives, by extractor and control loss.
    Extractors,
    /// What copies go through.
    Attacks,
    /// Seconds against accuracy and fidelity.
    Pareto,
    /// Where methods fail.
    Stability,
    /// No more than a scene needs.
    Fit,
    /// One extractor for all assets.
    General,
}

impl Substudy {
    /// All, in the order in which `all` runs them.
    pub const ALL: [Self; 10] = [
        Self::Table1,
        Self::Table2,
        Self::Table3,
        Self::Table4,
        Self::Extractors,
        Self::Attacks,
        Self::Pareto,
        Self::Stability,
        Self::Fit,
        Self::General,
    ];

    /// Name of its files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Table1 => "table1",
            Self::Table2 => "table2",
            Self::Table3 => "table3",
            Self::Table4 => "table4",
            Self::Extractors => "extractors",
            Self::Attacks => "attacks",
            Self::Pareto => "pareto",
            Self::Stability => "stability",
            Self::Fit => "fit",
            Self::General => "general",
        }
    }

    /// Its arms at a scale.
    fn arms(self, scale: &Scale) -> Vec<Arm> {
        match self {
            Self::Table1 => methods::table1(scale),
            Self::Table2 => methods::table2(scale),
            Self::Table3 => ablation::table3(scale),
            Self::Table4 => ablation::table4(scale),
            Self::Extractors => extractors::arms(scale),
            Self::Attacks => attacks::arms(scale),
            Self::Pareto => pareto::arms(scale),
            Self::Stability => stability::arms(scale),
            Self::Fit => fit::arms(scale),
            Self::General => general::arms(scale),
        }
    }

    /// Tables and charts of what was found.
    fn report(self, findings: &Findings) -> Report {
        match self {
            Self::Table1 => methods::report1(findings),
            Self::Table2 => methods::report2(findings),
            Self::Table3 => ablation::report3(findings),
            Self::Table4 => ablation::report4(findings),
            Self::Extractors => extractors::report(findings),
            Self::Attacks => attacks::report(findings),
            Self::Pareto => pareto::report(findings),
            Self::Stability => stability::report(findings),
            Self::Fit => fit::report(findings),
            Self::General => general::report(findings),
        }
    }
}

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

/// What a study is about to do.
#[derive(Clone, Copy, Debug)]
pub enum Step<'a> {
    /// Embedding number `index` of `len`, which is not in the ledger.
    Embedding {
        /// Arm, scene and seed.
        cell: &'a Cell,
        /// Number, from 0.
        index: usize,
        /// Embeddings of the sub-study.
        len: usize,
    },
    /// So many steps are taken.
    Training(usize),
    /// A film is made and read.
    Reading(&'a Take),
}

/// Told of every step; an error ends the study, which can be gone on with.
pub type Watcher<'a> = &'a mut dyn FnMut(Step<'_>) -> Result<(), EngineError>;

impl Study<'_> {
    /// Measures what the ledger does not have and writes the reports; says where.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for scenes of the same name; when the device is lost; when outputs cannot be written; and what
    /// `watch` says.
    pub fn run(&self, what: &[Substudy], watch: Watcher<'_>) -> Result<Vec<PathBuf>, EngineError> {
        self.check()?;
        let mut ledger = Ledger::open(&self.out.join(LEDGER))?;
        let mut lab = Lab::open(self.open, self.clip.clone(), self.out.join("keys"), &self.scale.scenes)?;
        let mut written = Vec::new();
        for &substudy in what {
            let cells = self.scale.cells(&substudy.arms(&self.scale));
            for (index, cell) in cells.iter().enumerate() {
                if is_measured(&ledger, cell, lab.machine()) {
                    continue;
                }
                watch(Step::Embedding { cell, index, len: cells.len() })?;
                ledger.append(lab.measure(cell, watch)?)?;
                // A study takes hours: what is there so far can be looked at.
                self.write(substudy, &cells, (&ledger, lab.machine()))?;
            }
            written.push(self.write(substudy, &cells, (&ledger, lab.machine()))?);
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
        substudy: Substudy,
        cells: &[Cell],
        (ledger, machine): (&Ledger, &Machine),
    ) -> Result<PathBuf, EngineError> {
        let findings = Findings::gather(cells, ledger, machine);
        substudy.report(&findings).write(&self.out, substudy.name(), (&findings, &self.command))
    }
}

/// Whether the ledger has all readings of a cell.
fn is_measured(ledger: &Ledger, cell: &Cell, machine: &Machine) -> bool {
    let id = cell.id(machine);
    cell.arm.takes.iter().all(|take| {
        let swapped = |row: &Row| *take != Take::Plain || !cell.arm.is_contested || row.swap_second.is_some();
        ledger.find(&id, &take.to_string()).is_some_and(|row| !row.error.is_empty() || swapped(row))
    })
}

/// Where a report's page is.
fn page(out: &Path, name: &str) -> PathBuf {
    out.join(format!("{name}.html"))
}
