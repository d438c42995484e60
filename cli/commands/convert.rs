//! `guard4d convert`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::output::{AtomicDir, AtomicFile, Existing};
use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::scene::formats::Export;
use guard4d_engine::scene::{Gaussians, Model};

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::shared::farm_job::{FarmJob, keep_in_records, overwrite};
use crate::shared::views::even_times;
use crate::shared::{device, model};
use crate::ui::outcome::Outcome;
use crate::ui::report::note;

/// What is written, and as what.
#[derive(Args, Debug)]
pub(crate) struct ConvertArgs {
    /// Model, as `inspect` can read it: a folder, or a file of splats
    model: PathBuf,
    /// File to write: .ply and .glb keep every coefficient to the bit, .spz rounds them
    ///
    /// With --moments a folder of PLYs.
    out: PathBuf,
    /// Moment of a moving model, 0 to 1
    #[arg(long, default_value_t = 0.0, value_name = "T", conflicts_with = "moments")]
    time: f32,
    /// A PLY for each of this many moments, spread over the whole motion, instead of one file
    #[arg(long, value_name = "N")]
    moments: Option<u32>,
    /// Write a format that rounds colours, which can cost bits of a mark
    #[arg(long)]
    lossy: bool,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "convert",
    has_input: true,
    needs_device: false,
    arguments: |row, attempt| {
        let places = ["--".to_owned(), row.input.clone(), row.output.clone()];
        overwrite(attempt).into_iter().chain(places).collect()
    },
    reserved: &["overwrite"],
    keep: keep_in_records,
    trial: None,
};

pub(crate) fn run(args: &ConvertArgs, common: &Common) -> Result<Outcome, EngineError> {
    let export = match args.moments {
        Some(_) => Export::Ply,
        None => Export::of(&args.out)?,
    };
    if !export.keeps_colours() && !args.lossy {
        return Err(EngineError::Usage {
            what: format!("{}", args.out.display()),
            got: "a format that rounds colours".to_owned(),
            expected: "--lossy with it, or a .ply or .glb".to_owned(),
        });
    }
    let opened = model::open(&args.model, common)?;
    // Only what moves needs a device.
    let device = (!opened.motion.is_still()).then(|| device::open(common)).transpose()?;
    let existing = args.overwrite.existing();
    let mut moments = Moments::new(&opened, device.as_ref())?;
    match args.moments {
        None => AtomicFile::write(&args.out, existing, &export.encode(&args.out, &moments.at(args.time)?)?)?,
        Some(count) => {
            let folder = AtomicDir::create(&args.out, existing)?;
            for (number, time) in even_times(count.max(1)).into_iter().enumerate() {
                let path = folder.path().join(format!("{number:05}.{}", export.extension()));
                AtomicFile::write(&path, Existing::Refuse, &export.encode(&path, &moments.at(time)?)?)?;
            }
            folder.commit()?;
        }
    }
    if !export.keeps_colours() {
        let out = args.out.display();
        note(common, &format!("note: whether a mark survived was not looked at; `guard4d verify {out}` does that"));
    }
    Ok(Outcome::Done)
}

/// Splats of a model at a moment.
struct Moments<'a> {
    model: &'a Model,
    field: Option<DeformField>,
}

impl<'a> Moments<'a> {
    /// A model that stands still needs no device.
    fn new(model: &'a Model, device: Option<&Device>) -> Result<Self, EngineError> {
        let field = device.map(|device| DeformField::new(device, &model.gaussians, &model.motion)).transpose()?;
        Ok(Self { model, field })
    }

    fn at(&mut self, time: f32) -> Result<Gaussians, EngineError> {
        if !(0.0..=1.0).contains(&time) {
            return Err(EngineError::Usage {
                what: "--time".to_owned(),
                got: time.to_string(),
                expected: "0 to 1".to_owned(),
            });
        }
        match &mut self.field {
            None => Ok(self.model.gaussians.clone()),
            Some(field) => field.at(time)?.read(),
        }
    }
}
