//! `guard4d convert`

use std::path::Path;

use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::deform::DeformField;
use guard4d_engine::media::frames::write_png_folder;
use guard4d_engine::output::{AtomicDir, AtomicFile, Existing};
use guard4d_engine::scene::formats::Export;
use guard4d_engine::scene::{Gaussians, Model};
use guard4d_engine::watermark::general::GeneralExtractor;
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::verify::{Case, Exhibits, Sought, clean_clips};
use guard4d_kernels::Device;

use crate::args::{Common, ConvertArgs};
use crate::media::read_options;
use crate::report::{Outcome, note, print};
use crate::verify::{human, outcome};
use crate::views::{cameras, even_times};
use crate::{devices, model};

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
    // Only what moves or is looked at needs a device.
    let device = (!opened.motion.is_still() || args.key.is_some()).then(|| devices::open(common)).transpose()?;
    let question = Question::read(args, common, device.as_ref())?;
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
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
    match question {
        Some(question) => question.read_again((args, common), &opened),
        None => {
            if !export.keeps_colours() {
                note(common, "note: whether a mark survived was not looked at; give --key and --receipt for that");
            }
            Ok(Outcome::Done)
        }
    }
}

/// Splats of a model at a moment.
struct Moments<'a> {
    model: &'a Model,
    field: Option<DeformField>,
}

impl<'a> Moments<'a> {
    fn new(model: &'a Model, device: Option<&Device>) -> Result<Self, EngineError> {
        let device = device.filter(|_| !model.motion.is_still());
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

/// What the mark is looked for with. It is read before anything is written, so that a wrong key leaves no file behind.
struct Question<'a> {
    device: &'a Device,
    clip: Clip,
    key: Key,
    sought: Option<Sought>,
    receipt: &'a Path,
    general: Option<GeneralExtractor>,
}

impl<'a> Question<'a> {
    fn read(args: &'a ConvertArgs, common: &Common, device: Option<&'a Device>) -> Result<Option<Self>, EngineError> {
        let (Some(device), Some(key), Some(receipt)) = (device, &args.key, &args.receipt) else { return Ok(None) };
        let clip = devices::load_clip(device, &ClipSource::from_argument(&args.clip), common)?;
        let key = Key::read(key, &clip)?;
        let sought = args.message.as_ref().map(|text| Sought::parse(text, &key)).transpose()?;
        let general = args.general.as_deref().map(GeneralExtractor::read).transpose()?;
        Ok(Some(Self { device, clip, key, sought, receipt, general }))
    }

    /// Films what was written of a model, as that is filmed, and looks for the mark.
    fn read_again(self, (args, common): (&ConvertArgs, &Common), model: &Model) -> Result<Outcome, EngineError> {
        let Self { device, clip, key, sought, receipt, general } = self;
        // A moment alone would be filmed from elsewhere, and files of splats say nothing of what is behind them.
        let mut written = Model::open(&args.out)?;
        written.background = model.background;
        let cameras = cameras(&args.views, model)?;
        let films = tempfile::tempdir().map_err(|source| EngineError::Io { path: std::env::temp_dir(), source })?;
        let mut exhibits = Exhibits::default();
        for (number, frames) in clean_clips(device, &written, &cameras)?.into_iter().enumerate() {
            let film = films.path().join(format!("view-{number}"));
            write_png_folder(&film, &frames)?;
            exhibits.suspects.push(film);
        }
        let case = Case { device, clip: &clip, key: &key, sought, receipt, general: general.as_ref() };
        let report = case.verify(&exhibits, &read_options())?;
        print(common, &report, human)?;
        Ok(outcome(&report))
    }
}
