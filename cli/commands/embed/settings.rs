//! The settings in force: a profile's numbers, what a file says instead, and what flags say instead of that.

use std::path::{Path, PathBuf};

use clap::{ArgMatches, FromArgMatches as _};
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::release::receipt::{Receipt, Schema};
use guard4d_engine::watermark::embed::{EmbedConfig, Profile};
use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::job::JobSettings;

/// Field of view of the views, degrees. In single precision, as flags are read: the views, and so the marks of a seed,
/// hang on its last bits.
const FOV_DEG: f32 = 39.6;

/// What an embedding is asked to do, and how it runs.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Settings {
    pub(crate) config: EmbedConfig,
    pub(crate) job: JobSettings,
}

impl Settings {
    /// A profile's numbers; a target fidelity moves with it what follows from it.
    pub(crate) fn of_profile(profile: Profile, mode: ExtractorMode, target_psnr: Option<f32>) -> Self {
        let config = EmbedConfig::new(profile, mode).with(|config| config.views.fov_deg = f64::from(FOV_DEG));
        let config = target_psnr.map_or(config.clone(), |target| config.with_target(target));
        Self { config, job: JobSettings::default() }
    }

    /// Those of a file and of flags. Networks are named, and not opened.
    pub(crate) fn new(file: Option<&Path>, given: &ArgMatches) -> Result<Self, EngineError> {
        let mut file = file.map(SettingsFile::read).transpose()?.unwrap_or_default();
        let in_file = (file.word::<Profile>(&["profile"])?, file.word::<ExtractorMode>(&["extractor", "mode"])?);
        let profile = EmbedConfig::profile_flag(given).or(in_file.0).unwrap_or(Profile::Balanced);
        let mode = EmbedConfig::mode_flag(given).or(in_file.1).unwrap_or(profile.default_mode());
        if in_file.1.is_some_and(|named| named != mode) {
            // Settings of another mode have no place.
            file.table.remove("extractor");
        }
        let asked = given.get_one::<f32>("target_psnr").copied();
        let Self { config, job } = Self::of_profile(profile, mode, asked.or(file.target_psnr()));
        if asked.is_some() {
            config.validate_numbers()?;
        }
        let (job_table, config_table) = file.table.into_iter().partition(|(key, _)| JOB.contains(&key.as_str()));
        let mut config: EmbedConfig = overlaid(&config, &config_table, &file.path)?;
        let mut job: JobSettings = overlaid(&job, &job_table, &file.path)?;
        config.validate_numbers().map_err(|error| in_the_file(error, &file.path))?;
        job.evaluation.validate().map_err(|error| in_the_file(error, &file.path))?;
        config.take_flags(given)?;
        job.update_from_arg_matches(given).map_err(|error| EngineError::Usage {
            what: "flags".to_owned(),
            got: error.to_string(),
            expected: "flags that go together".to_owned(),
        })?;
        take_views(given, &config, &mut job);
        config.validate_numbers()?;
        job.evaluation.validate()?;
        Ok(Self { config, job })
    }

    /// All of them as TOML, which [`Settings::new`] takes.
    pub(crate) fn to_toml(&self) -> String {
        let mut table = table_of(&self.config);
        table.extend(table_of(&self.job));
        toml::to_string(&table).expect("tables of plain values are TOML")
    }
}

/// Keys of [`JobSettings`].
const JOB: [&str; 3] = ["run", "gate", "evaluation"];

/// Flags of views that mean more than their own setting.
fn take_views(given: &ArgMatches, config: &EmbedConfig, job: &mut JobSettings) {
    let evaluation = &mut job.evaluation;
    if given.contains_id("size_px") && evaluation.frame_px.is_none() {
        evaluation.frame_px = Some(config.views.size_px);
    }
    if given.contains_id("orbit") {
        (evaluation.cameras, evaluation.interpolate, evaluation.closed) = (None, None, false);
    }
    if given.contains_id("cameras") {
        evaluation.orbit = None;
    }
}

/// A file of settings.
#[derive(Default)]
struct SettingsFile {
    path: PathBuf,
    table: Table,
}

impl SettingsFile {
    /// Reads TOML, or the settings of a receipt.
    fn read(path: &Path) -> Result<Self, EngineError> {
        let bytes = std::fs::read(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::NotFound => {
                EngineError::MissingInput { path: path.to_owned(), expected: "settings, or a receipt".to_owned() }
            }
            _ => EngineError::Io { path: path.to_owned(), source },
        })?;
        let bad = |field: &str, got: String, expected: &str| EngineError::BadData {
            path: path.to_owned(),
            field: field.to_owned(),
            got,
            expected: expected.to_owned(),
        };
        let table = if bytes.trim_ascii_start().starts_with(b"{") {
            let receipt = Receipt::parse(path, &bytes)?;
            receipt.verify_commitment(path)?;
            if receipt.schema == Schema::V1 {
                let expected = "guard4d.receipt/2, whose settings are spelled as flags and files are now";
                return Err(bad("schema", "guard4d.receipt/1".to_owned(), expected));
            }
            let config = receipt.body.settings.get("config").cloned().unwrap_or_default();
            Table::try_from(&config).map_err(|error| bad("settings.config", error.to_string(), "settings"))?
        } else {
            let text = String::from_utf8(bytes).map_err(|error| bad("text", error.to_string(), "UTF-8"))?;
            text.parse().map_err(|error: toml::de::Error| bad("text", error.to_string(), "TOML"))?
        };
        Ok(Self { path: path.to_owned(), table })
    }

    /// What stands at a place in it.
    fn at(&self, place: &[&str]) -> Option<&Value> {
        let (first, rest) = place.split_first()?;
        rest.iter().try_fold(self.table.get(*first)?, |value, key| value.get(key))
    }

    /// A word there.
    fn word<T: DeserializeOwned>(&self, place: &[&str]) -> Result<Option<T>, EngineError> {
        let Some(value) = self.at(place) else { return Ok(None) };
        value.clone().try_into().map(Some).map_err(|error| bad_value(&self.path, &place.join("."), value, &error))
    }

    #[allow(clippy::cast_possible_truncation, reason = "fidelities are single precision")]
    fn target_psnr(&self) -> Option<f32> {
        let value = self.at(&["fidelity", "target_psnr"])?;
        value.as_float().or(value.as_integer().map(|whole| whole as f64)).map(|psnr| psnr as f32)
    }
}

/// Settings with those of a file in their place.
fn overlaid<T: Serialize + DeserializeOwned>(base: &T, over: &Table, path: &Path) -> Result<T, EngineError> {
    let base = table_of(base);
    let with = |over: &Table| {
        let mut merged = base.clone();
        merge(&mut merged, over);
        merged.try_into::<T>()
    };
    with(over).map_err(|error| {
        // What is wrong by itself has a place that can be named.
        let wrong = leaves(over, "").into_iter().find_map(|(place, alone, value)| {
            let error = with(&alone).err()?;
            Some(bad_value(path, &place, &value, &error))
        });
        wrong.unwrap_or_else(|| bad_value(path, "settings", &Value::Table(over.clone()), &error))
    })
}

/// Plain values with single precision in no more digits than it has.
pub(crate) fn table_of<T: Serialize>(settings: &T) -> Table {
    let text = serde_json::to_string(settings).expect("numbers and words are valid JSON");
    let json: serde_json::Value = serde_json::from_str(&text).expect("it was written as JSON");
    Table::try_from(json).expect("settings have no empty values")
}

/// Puts the values of `over` in the place of those in `into`, table by table.
fn merge(into: &mut Table, over: &Table) {
    for (key, value) in over {
        match (into.get_mut(key), value) {
            (Some(Value::Table(into)), Value::Table(over)) => merge(into, over),
            _ => {
                into.insert(key.clone(), value.clone());
            }
        }
    }
}

/// Every value that is no table: its place, a table with it alone, and itself.
fn leaves(table: &Table, prefix: &str) -> Vec<(String, Table, Value)> {
    let leaf = |(key, value): (&String, &Value)| {
        let wrap = |inner: Value| Table::from_iter([(key.clone(), inner)]);
        match value {
            Value::Table(inner) if !inner.is_empty() => {
                let below = leaves(inner, &format!("{prefix}{key}.")).into_iter();
                below.map(|(place, alone, value)| (place, wrap(Value::Table(alone)), value)).collect()
            }
            _ => vec![(format!("{prefix}{key}"), wrap(value.clone()), value.clone())],
        }
    };
    table.iter().flat_map(leaf).collect()
}

fn bad_value(path: &Path, field: &str, value: &Value, error: &toml::de::Error) -> EngineError {
    let said = error.message();
    let expected = match said.split_once("expected ") {
        Some((_, expected)) if said.starts_with("unknown field") => format!("no such key, but {expected}"),
        Some((_, expected)) => expected.to_owned(),
        None => said.to_owned(),
    };
    EngineError::BadData { path: path.to_owned(), field: field.to_owned(), got: value.to_string(), expected }
}

/// What is impossible, and stands in a file.
fn in_the_file(error: EngineError, path: &Path) -> EngineError {
    match error {
        EngineError::Usage { what, got, expected } => {
            EngineError::BadData { path: path.to_owned(), field: what, got, expected }
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use clap::{Args as _, Command};
    use guard4d_engine::evidence::extractor_mode::ExtractorMode;
    use guard4d_engine::watermark::embed::Profile;

    use super::super::args::Given;
    use super::Settings;

    /// The settings of a file with this text, and of flags.
    fn settings(text: &str, flags: &[&str]) -> Result<Settings, String> {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("settings.toml");
        std::fs::write(&path, text).expect("writable");
        let flags = ["embed"].iter().chain(flags);
        let given = Given::augment_args(Command::new("embed")).try_get_matches_from(flags).expect("flags that exist");
        Settings::new(Some(&path), &given).map_err(|error| format!("{} {error}", error.exit_code()))
    }

    #[test]
    fn what_is_shown_is_the_same_when_it_is_read() {
        for profile in Profile::ALL {
            for mode in ExtractorMode::ALL {
                let settings_of = Settings::of_profile(profile, mode, Some(41.3));
                let shown = settings_of.to_toml();
                let read = settings(&shown, &[]).expect("it was shown");
                assert_eq!(read, settings_of, "{shown}");
                assert_eq!(read.to_toml(), shown, "{profile} {mode}");
            }
        }
    }

    #[test]
    fn flags_come_before_the_file_and_the_file_before_the_profile() {
        let file =
            "profile = \"draft\"\n[optimiser]\nsteps = 7\n[views]\nclips = 5\nradius = 3\n[run]\nfit = \"auto\"\n";
        let Settings { config, job } = settings(file, &["--steps", "9", "--lossy"]).expect("settings");
        assert_eq!((config.profile, config.optimiser.steps, config.views.clips), (Profile::Draft, 9, 5));
        assert_eq!((config.views.radius, job.run.fit.to_string().as_str(), job.run.lossy), (Some(3.0), "auto", true));
        let usual = Settings::of_profile(Profile::Draft, ExtractorMode::Blind, None);
        assert_eq!(config.objective, usual.config.objective, "the profile's");
        let louder = settings("[fidelity]\ntarget_psnr = 40\n", &[]).expect("settings").config;
        assert_eq!(louder, Settings::of_profile(Profile::Balanced, ExtractorMode::Blind, Some(40.0)).config);
        let joint = "[extractor]\nmode = \"joint\"\ncontrol_every = 3\n";
        let every = |settings: Settings| settings.config.extractor.joint().map(|joint| joint.control_every);
        assert_eq!(every(settings(joint, &[]).expect("settings")), Some(3));
        assert_eq!(every(settings(joint, &["--extractor", "blind"]).expect("settings")), None, "left aside");
    }

    #[test]
    fn what_a_file_cannot_say_is_refused_by_its_place() {
        for (text, words) in [
            ("[views]\nradius = \"far\"\n", "views.radius: \"far\", expected f64"),
            ("[views]\nradii = 3\n", "views.radii: 3, expected no such key, but one of"),
            ("speed = 3\n", "speed: 3, expected no such key"),
            ("profile = \"best\"\n", "profile: \"best\", expected one of"),
            ("[extractor]\ncontrol_every = 3\n", "extractor.control_every: 3, expected no such key"),
            ("[extractor.calibration]\nprobes = -1\n", "extractor.calibration.probes: -1"),
            ("[optimiser]\nsteps = 0\n", "steps: 0, expected at least 1"),
            ("[evaluation]\ninterpolate = 3\n", "interpolate: no cameras"),
            ("[gate\n", "text: "),
        ] {
            let refused = settings(text, &[]).expect_err(text);
            assert!(refused.starts_with("65 ") && refused.contains(words), "`{words}` is not in: {refused}");
        }
        for (flags, words) in [
            (["--control-every", "3"], "--control-every: extractor `blind`, expected extractor `joint`"),
            (["--lambda-lpips", "1"], "--lpips <FILE>"),
            (["--steps", "0"], "steps: 0, expected at least 1"),
        ] {
            let refused = settings("", &flags).expect_err(words);
            assert!(refused.starts_with("2 ") && refused.contains(words), "`{words}` is not in: {refused}");
        }
    }
}
