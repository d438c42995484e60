//! Arguments of `guard4d study`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use guard4d_engine::study::SceneSource;

use super::EffortArgs;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum StudyPart {
    /// The paper's Table 1: methods
    Table1,
    /// The paper's Table 2: message lengths
    Table2,
    /// The paper's Table 3: terms of the loss
    Table3,
    /// The paper's Table 4: control clips
    Table4,
    /// Where the message lives, by extractor and control loss
    Extractors,
    /// Distorted films
    Attacks,
    /// Seconds against accuracy and fidelity
    Pareto,
    /// Hard scenes, films, lengths and sizes
    Stability,
    /// Stopping early against taking all steps
    Fit,
    /// One extractor for all assets against one fitted to each
    General,
    /// All of them
    All,
}

#[derive(Args, Debug)]
pub(crate) struct StudyArgs {
    /// What to measure
    #[arg(value_enum, required = true)]
    pub(crate) what: Vec<StudyPart>,
    /// Folder for readings, keys and reports; what is there is gone on with
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Small frames, few steps and fewer arms: each part ends within 15 minutes on two processor cores
    #[arg(long)]
    pub(crate) quick: bool,
    /// Scenes: demo, or models as `inspect` can read them [default: demo]
    #[arg(long, value_delimiter = ',')]
    pub(crate) scenes: Vec<SceneSource>,
    /// Seeds of keys, messages, views, times and noise [default: 0,1,2; with --quick: 0]
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u8).range(..=253))]
    pub(crate) seeds: Vec<u8>,
    /// Only arms whose name holds one of these words
    #[arg(long, value_name = "WORDS", value_delimiter = ',')]
    pub(crate) only: Vec<String>,
    /// Side of frames in pixels [default: 400; with --quick: 100]
    #[arg(long, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub(crate) size: Option<u32>,
    #[command(flatten)]
    pub(crate) effort: EffortArgs,
    /// CLIP checkpoint: `mini` or a folder
    #[arg(long, default_value = "mini")]
    pub(crate) clip: String,
    /// General extractor, as `embed` takes it
    #[arg(long, value_name = "FILE")]
    pub(crate) general: Option<PathBuf>,
    /// LPIPS weights, as `embed` takes them: part of the paper's objective, and one more figure of its rows
    #[arg(long, value_name = "FILE")]
    pub(crate) lpips: Option<PathBuf>,
}
