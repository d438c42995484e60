//! What the command line of `embed` names, opened and checked.

use std::path::Path;
use std::sync::Arc;

use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::id_code::IdBits;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::payload::Payload;
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::release::delivery;
use guard4d_engine::release::gate::Gate;
use guard4d_engine::scene::{CameraSet, Model};
use guard4d_engine::watermark::embed::{EmbedConfig, Subject, TrainingViews};
use guard4d_engine::watermark::key::owner_key::Key;

use super::args::What;
use super::job::{Fit, GateSettings, JobSettings, LeastAccuracy, RunSettings};
use super::settings::Settings;
use crate::flags::common::Common;
use crate::flags::passphrase;
use crate::shared::views::evaluation_cameras;
use crate::shared::{device, model};

/// Everything that work begins with.
pub(super) struct Inputs {
    pub(super) device: Device,
    pub(super) clip: Arc<ClipModel>,
    pub(super) key: Key,
    pub(super) model: Model,
    pub(super) message: Message,
    pub(super) payload: Option<IdBits>,
    pub(super) cameras: CameraSet,
    pub(super) config: EmbedConfig,
    pub(super) gate: Gate,
    pub(super) class_films: u32,
}

impl Inputs {
    pub(super) fn open(
        path: &Path,
        key: &Path,
        what: &What,
        settings: Settings,
        common: &Common,
    ) -> Result<Self, EngineError> {
        let device = device::open(common)?;
        let clip = device::load_clip(&device, &what.clip, common)?;
        let owner = passphrase::key(what.passphrase_file.as_deref(), key, &clip, common)?;
        let bits = u32::try_from(owner.bits()).unwrap_or(u32::MAX);
        let payload = Payload::parse(&what.message, bits)?;
        let Settings { mut config, job } = settings;
        config.open_weights()?;
        let searched = payload.id_bits().map_or(1, IdBits::num_ids).saturating_mul(config.extractor.rotations());
        let gate = gate(&job, owner.bits(), searched)?;
        let config = match job.run.fit {
            Fit::Auto => config.adaptive(gate.aim(), owner.bits()),
            Fit::Full => config,
        };
        let open = if job.run.lossy { model::open_lossy } else { model::open };
        let model = open(path, common)?;
        // Files that cannot be written in place are refused before the work, not after it.
        model.check_writable()?;
        let key = owner.for_asset(model.digest())?;
        // Who cannot sign the receipt is told before the work, too.
        delivery::signer_of(&key, model.digest())?;
        let message = payload.message(&key.prf())?;
        let views = training_views(&job.run, config.views.clone())?;
        let look_at = views.look_at(&model);
        let config = config.with(|config| config.views = views.looking_at(look_at));
        let (payload, cameras) = (payload.id_bits(), evaluation_cameras(&job.evaluation, &config.views, &model)?);
        let class_films = job.evaluation.class_films;
        Ok(Self { device, clip, key, model, message, payload, cameras, config, gate, class_films })
    }

    pub(super) fn subject(&self) -> Subject<'_> {
        let Self { device, clip, key, model, message, .. } = self;
        Subject { device, clip, key, model, message }
    }
}

/// Where training looks from: near the cameras of a capture where one is named.
fn training_views(run: &RunSettings, views: TrainingViews) -> Result<TrainingViews, EngineError> {
    let Some(path) = &run.train_cameras else { return Ok(views) };
    let capture = CameraSet::open(path, views.lens()?.size)?;
    views.near(&capture)
}

/// What is asked of the result, or what a message of its length needs that is one of so many claims.
fn gate(job: &JobSettings, bits: usize, searched: u32) -> Result<Gate, EngineError> {
    let GateSettings { min_accuracy, min_psnr } = &job.gate;
    let mut gate = Gate { min_psnr_db: *min_psnr, ..Gate::after_search(bits, searched) };
    for LeastAccuracy { class, share } in min_accuracy {
        match class {
            Some(class) => _ = gate.min_class_accuracy.insert(*class, *share),
            None => (gate.min_proven, gate.min_accuracy) = (0.0, Some(*share)),
        }
    }
    gate.validate()?;
    if !gate.min_class_accuracy.is_empty() && job.evaluation.class_films == 0 {
        return Err(EngineError::Usage {
            what: "least bit accuracy of a class".to_owned(),
            got: "class-films 0".to_owned(),
            expected: "at least one film of each class".to_owned(),
        });
    }
    Ok(gate)
}
