//! The choice among the commands.

use clap::{Args, Subcommand};
use guard4d_engine::error::EngineError;

use super::chips::{self, ChipsArgs};
use super::dump::{self, DumpArgs};
use super::host::Host;
use super::isa::{self, IsaArgs};
use super::locating::{self, LocatingArgs};
use super::pretrain::{self, PretrainArgs};
use super::study::{self, StudyArgs};
use super::tracing::{self, TracingArgs};

/// Arguments of `guard4d lab`.
#[derive(Args, Debug)]
pub struct LabArgs {
    #[command(subcommand)]
    command: LabCommand,
}

#[derive(Debug, Subcommand)]
enum LabCommand {
    /// Measures how well marks are read, what they cost and where that fails; writes CSV, JSON, SVG and a page for each
    /// part
    ///
    /// Readings are kept in OUT/readings.csv as soon as they are made; the same command goes on where it was. Nothing
    /// is measured twice that several parts need.
    Study(StudyArgs),
    /// Measures how well copies are told apart: stamped, spoilt, filmed, encoded, traced
    Tracing(TracingArgs),
    /// Measures how well films of unknown cameras are located
    Locating(LocatingArgs),
    /// Measures how well the owner's chips are read from each class of cameras, by the key and by 10,000 others
    Chips(ChipsArgs),
    /// Makes a pretrained extractor from random scenes and offsets: nobody's key or message takes part
    ///
    /// For `embed --extractor pretrained` with another CLIP than the built-in one, for which an extractor is built in.
    Pretrain(PretrainArgs),
    /// Runs one operation from a file to a file, for comparison with other implementations
    Dump(DumpArgs),
    /// Asks a driver what its compiler makes of every kernel: registers, spills, instructions; runs nothing
    ///
    /// A driver need not have its hardware: Mesa's RADV compiles for the family in RADV_FORCE_FAMILY. `./x isa` does
    /// this for several.
    Isa(IsaArgs),
}

/// Runs a command.
///
/// # Errors
/// Those of the command.
pub fn run(args: &LabArgs, host: &dyn Host) -> Result<(), EngineError> {
    match &args.command {
        LabCommand::Study(args) => study::run(args, host),
        LabCommand::Tracing(args) => tracing::run(args, host),
        LabCommand::Locating(args) => locating::run(args, host),
        LabCommand::Chips(args) => chips::run(args, host),
        LabCommand::Pretrain(args) => pretrain::run(args, host),
        LabCommand::Dump(args) => dump::run(args, host),
        LabCommand::Isa(args) => isa::run(args, host),
    }
}
