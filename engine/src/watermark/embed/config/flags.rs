//! The settings as flags of a command line.

use clap::error::ErrorKind;
use clap::{Arg, ArgMatches, Args, Command, Id};

use super::embed_config::EmbedConfig;
use super::extractor::{BlindConfig, Extractor, JointConfig, NoneConfig, PretrainedConfig};
use super::fidelity::Fidelity;
use super::objective::Objective;
use super::optimiser::Optimiser;
use super::profile::Profile;
use super::terms::LpipsTerm;
use super::training_views::TrainingViews;
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;

/// Flag of [`EmbedConfig::profile`].
const PROFILE: &str = "profile";
/// Flag of [`EmbedConfig::seed`].
const SEED: &str = "seed";
/// Flag that chooses among [`Extractor`]s.
const EXTRACTOR: &str = "extractor";
/// Flag without which there is no LPIPS.
const LPIPS: &str = "network";

impl EmbedConfig {
    /// Adds a flag for every setting that has one. None has a default: what is not given stays as it is.
    #[must_use]
    pub fn add_flags(command: Command) -> Command {
        let profile = Arg::new(PROFILE)
            .long(PROFILE)
            .value_name("PROFILE")
            .value_parser(str::parse::<Profile>)
            .help("How much work to spend: draft, balanced (default); the paper's: faithful, guardsplat, multi-frame")
            .long_help(
                "How much work to spend\n\n`draft` is fast and coarse, for a first look; `balanced` the default. \
                 `faithful` has the paper's objective and weights, with extractor `joint` unless told otherwise; \
                 `guardsplat` is its single-frame baseline, with `none`; `multi-frame` is the same on clips of one \
                 camera.",
            );
        let seed = Arg::new(SEED)
            .long(SEED)
            .value_name("SEED")
            .value_parser(clap::value_parser!(u64))
            .hide(true)
            .help("Seed of views, times and noise");
        let command = TrainingViews::augment_args_for_update(command);
        let command = command.next_help_heading("Quality").arg(profile).arg(seed);
        let command = Fidelity::augment_args_for_update(command);
        let command = Objective::augment_args_for_update(command);
        let command = LpipsTerm::augment_args_for_update(command);
        let command = Optimiser::augment_args_for_update(command);
        Extractor::add_flags(command).next_help_heading(None)
    }

    /// The profile that flags name.
    #[must_use]
    pub fn profile_flag(matches: &ArgMatches) -> Option<Profile> {
        matches.get_one(PROFILE).copied()
    }

    /// The extractor that flags name.
    #[must_use]
    pub fn mode_flag(matches: &ArgMatches) -> Option<ExtractorMode> {
        matches.get_one(EXTRACTOR).copied()
    }

    /// Replaces what flags say.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a flag that the extractor of these settings has no use for, and for those of LPIPS
    /// without a network.
    pub fn take_flags(&mut self, matches: &ArgMatches) -> Result<(), EngineError> {
        self.profile = Self::profile_flag(matches).unwrap_or(self.profile);
        self.seed = matches.get_one(SEED).copied().unwrap_or(self.seed);
        update(&mut self.views, matches)?;
        update(&mut self.fidelity, matches)?;
        update(&mut self.objective, matches)?;
        update(&mut self.optimiser, matches)?;
        if matches.contains_id(LPIPS) {
            self.objective.lpips.get_or_insert_default();
        }
        match &mut self.objective.lpips {
            Some(term) => update(term, matches)?,
            None => {
                if let Some(flag) =
                    flags_of::<LpipsTerm>().into_iter().find(|flag| matches.contains_id(flag.id.as_str()))
                {
                    return Err(EngineError::Usage {
                        what: flag.long,
                        got: "no network".to_owned(),
                        expected: "LPIPS weights with --lpips <FILE>".to_owned(),
                    });
                }
            }
        }
        self.extractor.take_flags(matches)
    }
}

impl Extractor {
    /// The flags of all modes, each once.
    fn add_flags(command: Command) -> Command {
        let mode = Arg::new(EXTRACTOR)
            .long(EXTRACTOR)
            .value_name("MODE")
            .value_parser(str::parse::<ExtractorMode>)
            .hide(true)
            .help(
                "What a frame passes through before CLIP, and so what a match proves: none, blind, pretrained or joint",
            )
            .long_help(
                "What a frame passes through before CLIP, and so what a match proves\n\n`none` is CLIP and the decoder \
                 alone; `blind` a front end that never saw the message; `pretrained` the same with directions learned \
                 once from other scenes: all with exact p-values. `joint` is the paper's front end, trained with the \
                 message: only empirical false-positive rates. By default `blind`; with the paper's profiles what they \
                 are about. Another mode than a settings file's leaves that file's extractor aside.",
            );
        let mut command = command.next_help_heading("Extractor").arg(mode);
        for flag in ExtractorMode::ALL.into_iter().flat_map(flags_of_mode) {
            if command.get_arguments().all(|known| *known.get_id() != flag.id) {
                command = command.arg(flag.arg);
            }
        }
        command
    }

    fn take_flags(&mut self, matches: &ArgMatches) -> Result<(), EngineError> {
        let own = flags_of_mode(self.mode());
        for flag in ExtractorMode::ALL.into_iter().flat_map(flags_of_mode) {
            if matches.contains_id(flag.id.as_str()) && own.iter().all(|known| known.id != flag.id) {
                let is_among = |mode: &ExtractorMode| flags_of_mode(*mode).iter().any(|known| known.id == flag.id);
                let modes = ExtractorMode::ALL.into_iter().filter(is_among).map(|mode| format!("`{mode}`"));
                return Err(EngineError::Usage {
                    what: flag.long,
                    got: format!("extractor `{}`", self.mode()),
                    expected: format!(
                        "extractor {}, which alone has this setting",
                        modes.collect::<Vec<_>>().join(" or ")
                    ),
                });
            }
        }
        match self {
            Self::None(none) => update(none, matches),
            Self::Blind(blind) => update(blind, matches),
            Self::Pretrained(pretrained) => update(pretrained, matches),
            Self::Joint(joint) => update(joint, matches),
        }
    }
}

/// A flag of some settings.
struct Flag {
    id: Id,
    /// As it is written.
    long: String,
    arg: Arg,
}

fn flags_of<T: Args>() -> Vec<Flag> {
    let command = T::augment_args_for_update(Command::new("settings"));
    let flag = |arg: &Arg| Flag {
        id: arg.get_id().clone(),
        long: format!("--{}", arg.get_long().unwrap_or_default()),
        arg: arg.clone(),
    };
    command.get_arguments().map(flag).collect()
}

fn flags_of_mode(mode: ExtractorMode) -> Vec<Flag> {
    match mode {
        ExtractorMode::None => flags_of::<NoneConfig>(),
        ExtractorMode::Blind => flags_of::<BlindConfig>(),
        ExtractorMode::Pretrained => flags_of::<PretrainedConfig>(),
        ExtractorMode::Joint => flags_of::<JointConfig>(),
    }
}

fn update<T: Args>(settings: &mut T, matches: &ArgMatches) -> Result<(), EngineError> {
    settings.update_from_arg_matches(matches).map_err(|error| EngineError::Usage {
        what: "flags".to_owned(),
        got: error.to_string(),
        expected: match error.kind() {
            ErrorKind::MissingRequiredArgument => "all that belong together",
            _ => "flags that go together",
        }
        .to_owned(),
    })
}
