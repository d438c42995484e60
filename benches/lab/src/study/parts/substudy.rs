//! The table of sub-studies. A new one is a line of it.

use super::{ablation, attacks, extractors, fit, methods, pareto, pretrained, stability};
use crate::report::Report;
use crate::study::plan::{Arm, Scale};
use crate::study::summary::Findings;

/// One question, and how it is answered.
#[derive(Clone, Copy, Debug)]
pub struct Substudy {
    /// Name on the command line and of its files.
    pub name: &'static str,
    /// What it is about.
    pub about: &'static str,
    /// Its arms at a scale.
    pub(in crate::study) arms: fn(&Scale) -> Vec<Arm>,
    /// Tables and charts of what was found.
    pub(in crate::study) report: fn(&Findings) -> Report,
}

/// All, in the order in which `all` runs them.
pub const SUBSTUDIES: [Substudy; 10] = [
    Substudy { name: "table1", about: "The paper's Table 1: methods", arms: methods::table1, report: methods::report1 },
    Substudy {
        name: "table2",
        about: "The paper's Table 2: message lengths",
        arms: methods::table2,
        report: methods::report2,
    },
    Substudy {
        name: "table3",
        about: "The paper's Table 3: terms of the loss",
        arms: ablation::table3,
        report: ablation::report3,
    },
    Substudy {
        name: "table4",
        about: "The paper's Table 4: control clips",
        arms: ablation::table4,
        report: ablation::report4,
    },
    Substudy {
        name: "extractors",
        about: "Where the message lives, by extractor and control loss",
        arms: extractors::arms,
        report: extractors::report,
    },
    Substudy { name: "attacks", about: "Distorted films", arms: attacks::arms, report: attacks::report },
    Substudy {
        name: "pareto",
        about: "Seconds against accuracy and fidelity",
        arms: pareto::arms,
        report: pareto::report,
    },
    Substudy {
        name: "stability",
        about: "Hard scenes, films, lengths and sizes",
        arms: stability::arms,
        report: stability::report,
    },
    Substudy { name: "fit", about: "Stopping early against taking all steps", arms: fit::arms, report: fit::report },
    Substudy {
        name: "pretrained",
        about: "One extractor for all assets against one fitted to each",
        arms: pretrained::arms,
        report: pretrained::report,
    },
];
