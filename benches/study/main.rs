//! Accuracy of the watermark against fidelity and cost, on views and times that nobody trained on.
//!
//! `./x study --models DIR…` marks every model in every mode at every fidelity with every seed, reads the mark back
//! from 8-bit frames of the model's `transforms_test.json`, and appends one row per embedding to `study.tsv` as soon
//! as it is measured. Rows that are there already are skipped; `study.md` and `study.svg` are made from all of them.
//!
//! `./x study --speed` measures what makes an embedding faster instead, and writes `speed.csv`.

mod chart;
#[path = "../host.rs"]
mod host;
mod ledger;
mod measure;
mod row;
mod speed;
mod summary;
#[path = "../svg.rs"]
mod svg;

use std::path::{Path, PathBuf};

use clap::{Parser, ValueEnum};
use guard4d_engine::EngineError;
use guard4d_engine::output::{AtomicFile, Existing};
use guard4d_engine::watermark::embed::Profile;
use guard4d_engine::watermark::evidence::ExtractorMode;
use guard4d_kernels::{DeviceSelect, FamilySelect};

use ledger::Ledger;
use measure::{Case, Study};

/// Charts the accuracy of embeddings against their fidelity and cost. Paths are relative to the repository.
#[derive(Debug, Parser)]
#[command(name = "./x study")]
pub(crate) struct Args {
    /// 4DGaussians folders with a `transforms_test.json`; each is "another scene" to the others
    #[arg(long, num_args = 1.., required_unless_present = "speed")]
    models: Vec<PathBuf>,
    /// Compare precisions, plans made again and controls now and then by time and accuracy, in `speed.csv`; without models
    /// on the built-in one
    #[arg(long, conflicts_with_all = ["modes", "rescale", "swap"])]
    speed: bool,
    /// Extractor modes
    #[arg(long, value_delimiter = ',', default_value = "none,blind,joint")]
    modes: Vec<Mode>,
    /// Whole-frame fidelities to embed at, in dB
    #[arg(long, value_delimiter = ',', default_value = "30,34,38,42")]
    psnr: Vec<f32>,
    /// Measure each mark also made stronger or weaker until training views are at these fidelities, in dB
    #[arg(long, value_delimiter = ',')]
    rescale: Vec<f32>,
    /// Seeds; each has a key, a message, views and times of its own
    #[arg(long, value_delimiter = ',', default_value = "0,1,2", value_parser = clap::value_parser!(u8).range(..=254))]
    seeds: Vec<u8>,
    /// Message bits
    #[arg(long, default_value_t = 16)]
    bits: u32,
    /// Side of all frames in pixels
    #[arg(long, default_value_t = 200)]
    size: u32,
    /// Training steps, instead of the profile's
    #[arg(long)]
    steps: Option<usize>,
    /// Training clips, instead of the profile's
    #[arg(long)]
    clips: Option<u32>,
    /// Where all other settings come from
    #[arg(long, value_enum, default_value = "draft")]
    profile: ProfileArg,
    /// Message swap: embed another message through the same frozen extractor too; takes twice the time
    #[arg(long)]
    swap: bool,
    /// CLIP checkpoint: `mini` or a folder
    #[arg(long, default_value = "mini")]
    clip: String,
    /// Vulkan device, as in `guard4d --help`
    #[arg(long, default_value = "auto", env = "GUARD4D_DEVICE")]
    device: DeviceSelect,
    /// Kernels to run on it: auto, lanes or tiles
    #[arg(long, default_value = "auto", env = "GUARD4D_KERNELS")]
    kernels: FamilySelect,
    /// Folder for rows, summary and chart [default: benches/results/DATE-DEVICE]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Folder that keeps the seeds' keys; they protect nothing, their secrets being the seeds
    #[arg(long, default_value = "target/study-keys")]
    keys: PathBuf,
    /// Given by cargo
    #[arg(long, hide = true)]
    bench: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Mode {
    None,
    Blind,
    Joint,
}

impl Mode {
    fn extractor(self) -> ExtractorMode {
        match self {
            Self::None => ExtractorMode::None,
            Self::Blind => ExtractorMode::Blind,
            Self::Joint => ExtractorMode::Joint,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ProfileArg {
    Draft,
    Balanced,
}

impl ProfileArg {
    fn profile(self) -> Profile {
        match self {
            Self::Draft => Profile::Draft,
            Self::Balanced => Profile::Balanced,
        }
    }
}

fn main() -> Result<(), EngineError> {
    let args = Args::parse();
    if args.speed {
        return speed::run(&args);
    }
    let study = Study::open(&args)?;
    let folder = args.out.clone().unwrap_or_else(|| host::results(study.device()));
    let mut ledger = Ledger::open(&folder.join("study.tsv"), row::columns())?;
    // Seeds outermost: a run that is broken off has every curve with fewer seeds, not fewer curves.
    for &seed in &args.seeds {
        for model in 0..args.models.len() {
            for mode in &args.modes {
                for &target_psnr in &args.psnr {
                    let case = Case { model, mode: mode.extractor(), target_psnr, seed };
                    if study.is_measured(&ledger, &args, case) {
                        eprintln!("{}: is there", study.name(&args, case));
                        continue;
                    }
                    for measured in study.measure(&args, case)? {
                        ledger.append(measured.row())?;
                    }
                    summarise(&ledger, &folder)?;
                }
            }
        }
    }
    // Also when every row was there: rows may have come from another machine.
    summarise(&ledger, &folder)?;
    eprintln!("{}", folder.join("study.md").display());
    Ok(())
}

/// Writes tables and chart of all rows.
fn summarise(ledger: &Ledger, folder: &Path) -> Result<(), EngineError> {
    for (file, text) in [("study.md", summary::markdown(ledger)), ("study.svg", chart::svg(ledger))] {
        AtomicFile::write(&folder.join(file), Existing::Replace, text.as_bytes())?;
    }
    Ok(())
}
