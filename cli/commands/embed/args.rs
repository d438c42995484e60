//! Arguments of `guard4d embed`. What can stand in a settings file is in [`Settings`].
//!
//! [`Settings`]: super::settings::Settings

use std::path::PathBuf;

use clap::{ArgMatches, Args, Command, FromArgMatches};
use guard4d_engine::watermark::embed::EmbedConfig;

use super::job::JobSettings;
use crate::flags::overwrite::Overwrite;
use crate::flags::passphrase::PASSPHRASE_FILE;

/// What is embedded where, and how.
#[derive(Args, Debug)]
pub(crate) struct EmbedArgs {
    /// Model, as `inspect` can read it: a folder, or a file of splats
    #[arg(required_unless_present = "show_config")]
    pub(crate) model: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) what: What,
    #[command(flatten)]
    pub(crate) given: Given,
    #[command(flatten)]
    pub(crate) resources: Resources,
}

/// What goes in and out.
#[derive(Args, Debug)]
#[command(next_help_heading = "What")]
pub(crate) struct What {
    /// Owner key; --passphrase-file FILE opens one that is under a passphrase
    #[arg(long, required_unless_present = "show_config")]
    pub(crate) key: Option<PathBuf>,
    /// File whose first line is the passphrase of the key; most keys have none
    #[arg(long, value_name = "FILE", env = PASSPHRASE_FILE, hide = true)]
    pub(crate) passphrase_file: Option<PathBuf>,
    /// CLIP checkpoint that the key was made with: `mini` or a folder
    #[arg(long, default_value = "mini")]
    pub(crate) clip: String,
    /// hex:…, bits:…, id:12:N, id:16:N, or random: the key's own
    ///
    /// An id is a number that survives wrong bits. The key has a message of its own for every model.
    #[arg(long, default_value = "random")]
    pub(crate) message: String,
    /// Folder for the marked model, the private files and a preview
    #[arg(long, required_unless_present = "show_config")]
    pub(crate) out: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) overwrite: Overwrite,
    /// Settings: a TOML file, or the receipt of another embedding
    ///
    /// A profile's numbers give way to the file's, and those to flags. docs/reference/config.md names all keys. A
    /// receipt gives the same marked model again.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Print the settings in force as TOML, which --config takes, and end
    #[arg(long)]
    pub(crate) show_config: bool,
}

/// What a run may take.
#[derive(Args, Debug)]
#[command(next_help_heading = "Resources")]
pub(crate) struct Resources {
    /// Go on from the checkpoint of an interrupted run with the same arguments
    #[arg(long)]
    pub(crate) resume: bool,
    /// Write nothing: say how much device memory and time this would take
    ///
    /// It tries a few clips and steps.
    #[arg(long, conflicts_with = "resume")]
    pub(crate) dry_run: bool,
}

/// The settings that flags give; what is not given has no value here.
#[derive(Clone, Debug)]
pub(crate) struct Given(pub(crate) ArgMatches);

impl FromArgMatches for Given {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        Ok(Self(matches.clone()))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.0 = matches.clone();
        Ok(())
    }
}

impl Args for Given {
    fn augment_args(command: Command) -> Command {
        JobSettings::augment_args_for_update(EmbedConfig::add_flags(command))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}
