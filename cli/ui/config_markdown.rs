//! The settings of an embedding as a page of Markdown.

use std::fmt::Write as _;

use clap::{Arg, Args, Command};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::watermark::embed::{
    BlindConfig, CalibrationConfig, ColourConfig, EmbedConfig, Fidelity, JointConfig, LpipsTerm, NoneConfig, Objective,
    Optimiser, PretrainedConfig, Profile, TrainingViews,
};
use guard4d_engine::watermark::extractor::tmsd::TmsdConfig;
use toml::Value;

use super::markdown::{item, text_of};
use crate::commands::embed::job::{EvaluationSettings, GateSettings, RunSettings};
use crate::commands::embed::settings::{Settings, table_of};

const INTRODUCTION: &str = "\
`guard4d embed --config FILE` reads these keys from a TOML file, section by section. A profile's numbers give way to \
those of the file, and these to flags. Every key has a flag, which `embed --help` shows for the most usual ones only. \
`embed --show-config` prints the settings in force in this form.

A receipt can be given as FILE, too: its settings give the same marked model again. A network that settings name by \
`path` and `blake3` has to have that hash; a path is relative to the folder that the command runs in. What a path does \
not name is built in.

`embed --extractor MODE` leaves the section `extractor` of a file aside that names another mode. Where nothing says \
otherwise, `fidelity.target_psnr` also moves the rates, the colour levels and the largest offset, in proportion to the \
marks that it allows; with the paper's profiles it does not.";

const SCHEDULE: &str = "\
Phases of training, and when it ends before its last step. `embed --fit auto` makes a schedule for the message and the \
gate, and receipts record it; without one all steps are taken, with everything. `every` is the number of steps between \
two evaluations of held-out clips in the last phase, `patience` how many of them may show no progress, `held_out` the \
number of these clips. `aim.p_value`, `aim.proven` and `aim.accuracy` say when a mark is good enough: the largest \
p-value of a clip that proves the message alone, the least share of clips that do, and the least share of bits right. \
Each of `phases` has `bases`, `visibility_share`, `clips` and `steps`, none less than the phase before.";

/// A section of the file.
struct Section {
    path: &'static str,
    about: &'static str,
    flags: Vec<Arg>,
    /// Modes of the extractor that have it; all, if it is not about one.
    modes: Vec<ExtractorMode>,
}

/// The page.
pub(crate) fn config_markdown() -> String {
    let mut page = String::from(
        "# Settings of `embed`\n\nMade by `guard4d reference config` of the definitions that parse flags and files; do \
         not edit it by hand.\n\n",
    );
    page.push_str(&text_of(INTRODUCTION, ""));
    for section in sections() {
        let name =
            if section.path.is_empty() { "Without a section".to_owned() } else { format!("`[{}]`", section.path) };
        let _ = write!(page, "\n## {name}\n\n{}\n", text_of(section.about, ""));
        for flag in &section.flags {
            page.push_str(&entry(&section, flag));
        }
    }
    let _ = write!(page, "\n## `[schedule]`\n\n{}", text_of(SCHEDULE, ""));
    page
}

fn sections() -> Vec<Section> {
    let mut top = flags_of(EmbedConfig::add_flags(Command::new("embed")));
    top.retain(|flag| matches!(flag.get_id().as_str(), "profile" | "seed"));
    let [mode] = flags_of(EmbedConfig::add_flags(Command::new("embed")))
        .into_iter()
        .filter(|flag| flag.get_id() == "extractor")
        .map(|flag| flag.id("mode"))
        .collect::<Vec<_>>()
        .try_into()
        .expect("one flag chooses the mode");
    let section = |path, about, flags| Section { path, about, flags, modes: Vec::new() };
    let of =
        |path, about, flags: Vec<Arg>, modes: &[ExtractorMode]| Section { path, about, flags, modes: modes.to_vec() };
    let (none, blind) = (ExtractorMode::None, ExtractorMode::Blind);
    let (pretrained, joint) = (ExtractorMode::Pretrained, ExtractorMode::Joint);
    let nested = [flags::<CalibrationConfig>(), flags::<ColourConfig>(), flags::<TmsdConfig>()].concat();
    let mut own = vec![mode];
    for flag in
        [flags::<NoneConfig>(), flags::<BlindConfig>(), flags::<PretrainedConfig>(), flags::<JointConfig>()].concat()
    {
        if own.iter().chain(&nested).all(|known| known.get_id() != flag.get_id()) {
            own.push(flag);
        }
    }
    vec![
        section("", "Where the numbers come from that nothing else says, and what is drawn.", top),
        section("views", "Views that training takes.", flags::<TrainingViews>()),
        section("fidelity", "How faint the mark is, and where it may be.", flags::<Fidelity>()),
        section("objective", "What training makes small.", flags::<Objective>()),
        section("objective.lpips", "LPIPS; without `network` there is none.", flags::<LpipsTerm>()),
        section("optimiser", "Steps of Adam on the offsets.", flags::<Optimiser>()),
        of("extractor", "What frames pass through before CLIP.", own, &[none, blind, pretrained, joint]),
        of(
            "extractor.calibration",
            "How its directions are fitted.",
            flags::<CalibrationConfig>(),
            &[none, blind, joint],
        ),
        of("extractor.colours", "The colour map in front of R.", flags::<ColourConfig>(), &[blind, pretrained, joint]),
        of("extractor.tmsd", "Size of R.", flags::<TmsdConfig>(), &[joint]),
        section("run", "How it runs. Receipts do not record it.", flags::<RunSettings>()),
        section("gate", "What is asked of the result. Receipts do not record it.", flags::<GateSettings>()),
        section(
            "evaluation",
            "Where the result is measured. Receipts do not record it.",
            flags::<EvaluationSettings>(),
        ),
    ]
}

fn flags<T: Args>() -> Vec<Arg> {
    flags_of(T::augment_args_for_update(Command::new("embed")))
}

fn flags_of(command: Command) -> Vec<Arg> {
    command.get_arguments().cloned().collect()
}

/// A key: its flag, what it does, and what it is unless given.
fn entry(section: &Section, flag: &Arg) -> String {
    let key = flag.get_id().as_str();
    let values = flag.get_value_names().map_or_else(|| key.to_uppercase(), |names| names.join(" "));
    let help = flag.get_long_help().or_else(|| flag.get_help()).map(ToString::to_string).unwrap_or_default();
    let long = flag.get_long().unwrap_or_default();
    let place = if section.path.is_empty() { key.to_owned() } else { format!("{}.{key}", section.path) };
    let default = defaults(section, &place);
    item(&format!("`{place}`, `--{long} {values}`: {help}\n\n{default}"), "")
}

/// What a key is by profile, and by mode of the extractor where these differ.
fn defaults(section: &Section, place: &str) -> String {
    let modes = if section.modes.is_empty() { &ExtractorMode::ALL[..] } else { &section.modes };
    let mut found: Vec<(String, Vec<String>)> = Vec::new();
    let mut add = |value: String, of: String| match found.iter_mut().find(|(known, _)| *known == value) {
        Some((_, all)) => all.push(of),
        None => found.push((value, vec![of])),
    };
    for profile in Profile::ALL {
        let by_mode = modes.iter().filter_map(|mode| Some((mode, default(profile, *mode, place)?)));
        let by_mode: Vec<(&ExtractorMode, String)> = by_mode.collect();
        match &by_mode[..] {
            [] => {}
            [(_, value), others @ ..] if others.iter().all(|(_, other)| other == value) => {
                add(value.clone(), profile.to_string());
            }
            several => several.iter().for_each(|(mode, value)| add(value.clone(), format!("{profile} with {mode}"))),
        }
    }
    match &found[..] {
        [] => "Not set unless given.".to_owned(),
        [(value, _)] => format!("Unless given: `{value}`."),
        several => {
            let each = several.iter().map(|(value, profiles)| format!("`{value}` ({})", profiles.join(", ")));
            format!("Unless given: {}.", each.collect::<Vec<_>>().join("; "))
        }
    }
}

/// What a key is in a profile with this mode, if it is there.
fn default(profile: Profile, mode: ExtractorMode, place: &str) -> Option<String> {
    let Settings { config, job } = Settings::of_profile(profile, mode, None);
    let mut table = table_of(&config);
    table.extend(table_of(&job));
    let mut keys = place.split('.');
    let first = table.get(keys.next()?)?;
    keys.try_fold(first, |value, key| value.get(key)).map(written)
}

/// As a file has it, with no more digits than tell.
fn written(value: &Value) -> String {
    match value {
        Value::Float(number) => format!("{:?}", (number * 1e5).round() / 1e5),
        other => other.to_string(),
    }
}
