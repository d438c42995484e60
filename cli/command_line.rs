//! The command line: one type per command, one doc comment per flag.

use clap::{Parser, Subcommand};
use guard4d_lab::command::LabArgs;

use crate::commands::attack::AttackArgs;
use crate::commands::commit::CommitArgs;
use crate::commands::completions::CompletionsArgs;
use crate::commands::convert::ConvertArgs;
use crate::commands::demo::DemoArgs;
use crate::commands::disclose::DiscloseArgs;
use crate::commands::embed::args::EmbedArgs;
use crate::commands::farm::actions::FarmArgs;
use crate::commands::inspect::InspectArgs;
use crate::commands::keygen::KeygenArgs;
use crate::commands::ledger::LedgerArgs;
use crate::commands::locate::LocateArgs;
use crate::commands::man::ManArgs;
use crate::commands::reference::ReferenceArgs;
use crate::commands::render::RenderArgs;
use crate::commands::stamp::StampArgs;
use crate::commands::timestamp::TimestampArgs;
use crate::commands::trace::TraceArgs;
use crate::commands::undo::UndoArgs;
use crate::commands::verify::VerifyArgs;
use crate::flags::common::Common;
use crate::ui::outcome::EXIT_CODES;

/// Widest line of help, in columns.
const WIDEST: usize = 100;

/// Writes an owner's message into 4D Gaussian splat assets and reads it back from rendered video.
#[derive(Debug, Parser)]
#[command(name = "guard4d", version, after_help = EXIT_CODES, max_term_width = WIDEST)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
    #[command(flatten)]
    pub(crate) common: Common,
}

/// In the order of their use.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Marks the built-in scene, renders it to 8-bit video and reads the mark back
    Demo(DemoArgs),
    /// Makes an owner key
    ///
    /// It holds a token table and a message decoder, both derived from a master secret.
    Keygen(KeygenArgs),
    /// Writes a message into a model
    ///
    /// What --help does not show, and all else that can be set, stands in docs/reference/config.md, with its flags.
    Embed(Box<EmbedArgs>),
    /// Reads a mark from films, frames or a model, and says how sure that is
    Verify(Box<VerifyArgs>),
    /// Makes one root of many receipts, so that one date covers them all
    ///
    /// Beside each receipt it writes a proof that the receipt is under the root: receipt.proof.json for receipt.json. A
    /// proof names no other receipt. `verify` finds it there, and counts each claim once for every receipt of the root.
    Commit(CommitArgs),
    /// Has a receipt or a root dated by a time-stamping authority (RFC 3161)
    ///
    /// Nothing is sent: `request` writes a file for the authority, `attach` takes what it answered, `check` says what
    /// the date is worth.
    Timestamp(TimestampArgs),
    /// Hands over what a third party needs to verify one asset, and nothing more
    Disclose(DiscloseArgs),
    /// Restores the original of a marked model, byte for byte
    Undo(UndoArgs),
    /// Writes a copy of a model for each recipient, which tells it apart from all others
    Stamp(StampArgs),
    /// Says who got which copy
    ///
    /// The ledger is one private file, made by `stamp`.
    Ledger(LedgerArgs),
    /// Says from where, when and through which lens a film of a model was taken
    ///
    /// It needs the film and the unmarked model alone. `trace` does the same by itself where no cameras are given.
    Locate(LocateArgs),
    /// Says whose copy a leaked film or asset shows
    Trace(TraceArgs),
    /// Renders a model to 8-bit frames or a video
    Render(RenderArgs),
    /// Distorts a film as copies are distorted, to see what `verify` then reads
    Attack(AttackArgs),
    /// Writes a model, or a moment of a moving one, as a file for other programs
    Convert(ConvertArgs),
    /// Does many jobs, on one machine or on many: a row of a manifest for each
    ///
    /// What is done stays done when it is run again, and a row that fails stops no other.
    Farm(FarmArgs),
    /// Says what a model, key or receipt holds
    Inspect(InspectArgs),
    /// Lists the Vulkan devices
    Devices,
    /// Prints a script that completes commands and flags in a shell
    Completions(CompletionsArgs),
    /// Writes the manual pages, one for each command
    Man(ManArgs),
    /// Prints a page of the reference, as docs/reference holds it
    #[command(hide = true)]
    Reference(ReferenceArgs),
    /// Studies, pretraining of extractors, and single operations: tools for research on guard4d itself
    #[command(hide = true)]
    Lab(Box<LabArgs>),
}
