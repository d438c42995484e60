//! `guard4d locate`

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::PoisonError;

use clap::Args;
use guard4d_engine::base::checkpoint;
use guard4d_engine::base::output::AtomicFile;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::detect::exhibit::Beside;
use guard4d_engine::detect::gathered::KnownFilm;
use guard4d_engine::error::EngineError;
use guard4d_engine::locate::finding::{DEFAULT_FRAMES, Finding, LocateReport, Locating, Wanted};
use guard4d_engine::locate::so_far::Kept;
use guard4d_engine::locate::views::Vantage;
use guard4d_engine::media::FrameSource;
use guard4d_engine::media::png::png_bytes;
use guard4d_engine::render::making::Making;

use crate::flags::common::Common;
use crate::flags::near::NearArgs;
use crate::flags::overwrite::Overwrite;
use crate::shared::farm_job::{FarmJob, keep_in_records, resumed};
use crate::shared::media::read_options;
use crate::shared::{device, locator, model};
use crate::ui::outcome::Outcome;
use crate::ui::progress::ObserverBar;
use crate::ui::report::{print, table};
use crate::ui::stop;

/// What was filmed, and what is known of it.
#[derive(Args, Debug)]
pub(crate) struct LocateArgs {
    /// Film: a folder of PNG, JPEG or OpenEXR frames, or a video
    film: PathBuf,
    /// The unmarked model that it shows
    #[arg(long, value_name = "MODEL")]
    original: PathBuf,
    /// Camera file to write, as transforms JSON: the camera and time of each frame
    ///
    /// `render --cameras` films the original again from there, and `trace --cameras` takes it. Frames that were not
    /// looked at or not found are between those that were, and marked `"located": false`: they are drawn, and not read.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Look at this many frames at most, evenly spread over the film
    #[arg(long, value_name = "N", default_value_t = NonZeroU32::new(DEFAULT_FRAMES).expect("more than none"))]
    max_frames: NonZeroU32,
    #[command(flatten)]
    near: NearArgs,
    /// Go on from the checkpoint of an interrupted run with the same film and model; it is left beside OUT
    #[arg(long)]
    resume: bool,
    /// Also write a picture to judge by: frames, the original from where they were taken, and what differs
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    sheet: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "locate",
    has_input: true,
    needs_device: true,
    arguments: resumed,
    reserved: &["out", "overwrite", "resume"],
    keep: keep_in_records,
    trial: None,
};

pub(crate) fn run(args: &LocateArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    // Whether they may be written is known before the film is looked at.
    let existing = args.overwrite.existing();
    let file = AtomicFile::create(&args.out, existing)?;
    let sheet = args.sheet.as_deref().map(|path| AtomicFile::create(path, existing)).transpose()?;
    let checkpoint = checkpoint::path_beside(&args.out);
    if args.resume {
        // What cannot be read is told before anything is drawn.
        TensorFile::read(&checkpoint)?;
    }
    // What is no film is told before the original is drawn, too.
    let options = read_options();
    let source = FrameSource::open(&args.film, &options)?;
    let original = model::open_in_kind(&args.original, common)?;
    let near = locator::near(&args.near)?;
    let device = device::open(common)?;
    let shared = locator::of(&device, &original, Vantage::of(&near), common)?;
    let mut locator = shared.lock().unwrap_or_else(PoisonError::into_inner);
    let mut progress = ObserverBar::new(common);
    let kept = Some(Kept { path: &checkpoint, goes_on: args.resume });
    let wanted = Wanted { model: &original, path: &args.film, options: &options, most: args.max_frames };
    let Finding { cameras, report } = locator.film(wanted, kept, &mut progress)?;
    drop(progress);
    if let Some(cameras) = cameras {
        if let Some(sheet) = sheet {
            // What is a guess is shown, too.
            let shots = cameras.clips().concat().into_iter().map(Some).collect();
            let known = KnownFilm { path: &args.film, source: &source, shots };
            sheet.finish(&png_bytes(&Beside::sheet(&Beside::of(&device, &original, &[known])?)?))?;
        }
        file.finish(&cameras.film_json())?;
    }
    checkpoint::remove(&checkpoint);
    print(common, &report, human)?;
    Ok(Outcome::Located(report.verdict))
}

/// What was found, and how sure it is.
fn human(report: &LocateReport) -> String {
    let headline = match report.verdict {
        Locating::Located => "LOCATED: where the film was taken is known",
        Locating::Inconclusive => "INCONCLUSIVE: the original was not found in this film",
    };
    let looked_at = format!("{} of {}; {} located", report.looked_at, report.frames, report.located);
    let mut rows = vec![("frames looked at", looked_at), ("shots", report.shots.to_string())];
    if let Some(likeness) = report.likeness {
        rows.push(("likeness to the original", format!("{likeness:.2} of 1")));
    }
    if let Some(apart) = report.apart_px {
        rows.push(("from between neighbours", format!("{apart:.2} px")));
    }
    if let Some(gap) = report.gap_px {
        rows.push(("from either side", format!("{gap:.2} px apart")));
    }
    if let Some(fov) = report.fov_deg {
        rows.push(("horizontal field of view", format!("{fov:.1} degrees")));
    }
    if let Some([first, last]) = report.times {
        rows.push(("moments, first and last", format!("{first:.3}, {last:.3}")));
    }
    if let Some(Making { settings, times }) = report.making {
        let smaller = if times > 1 { ", and made smaller" } else { "" };
        rows.push(("drawn by", format!("{settings}{smaller}")));
    }
    if report.mirrored {
        rows.push(("mirrored", "yes".to_owned()));
    }
    if let Some(picture) = report.picture {
        rows.push(("picture between bars", format!("{}x{} px", picture.width, picture.height)));
    }
    format!("{headline}\n{}", table(&rows))
}
