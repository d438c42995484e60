//! Measures one case: embeds, films unseen views, reads.

use std::fmt;
use std::path::Path;

use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::media::Frame;
use guard4d_engine::output::Existing;
use guard4d_engine::scene::{CameraSet, ImageSize, Model};
use guard4d_engine::watermark::cross_examination::{
    CrossExamination, OtherScene, Witnesses, cross_examine, read_swap, swap_message,
};
use guard4d_engine::watermark::digest::Digest;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, Start, Subject};
use guard4d_engine::watermark::evaluate::{Evaluation, HeldOut};
use guard4d_engine::watermark::evidence::ExtractorMode;
use guard4d_engine::watermark::extractor::ExtractorWeights;
use guard4d_engine::watermark::key::{Key, digest_of};
use guard4d_engine::watermark::prf::MasterSecret;
use guard4d_engine::watermark::verify::clean_clips;
use guard4d_kernels::{Device, DeviceOptions};

use crate::Args;
use crate::host;
use crate::ledger::Ledger;
use crate::row::{IDENTITY, Measured, Origin, SecondCopy};

/// Hexadecimal digits that tell checkpoints and settings apart.
const SHORT_HASH: usize = 12;
/// Steps between two lines of progress.
const PROGRESS: usize = 100;

/// What is embedded where, and how faithfully.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Case {
    /// Index among the models.
    pub(crate) model: usize,
    pub(crate) mode: ExtractorMode,
    pub(crate) target_psnr: f32,
    pub(crate) seed: u8,
}

/// The strength at which a row measures a mark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Strength {
    /// As the embedding leaves it.
    Own,
    /// Made stronger or weaker until training views are at this PSNR, in dB.
    RescaledTo(f32),
}

impl Strength {
    /// Factor on the offsets.
    fn factor(self, embedded: &Embedded) -> f32 {
        match self {
            Self::Own => 1.0,
            Self::RescaledTo(psnr) => embedded.strength_for(psnr),
        }
    }
}

impl fmt::Display for Strength {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Own => Ok(()),
            Self::RescaledTo(psnr) => write!(f, "{psnr}"),
        }
    }
}

/// All that a case is measured at.
fn strengths(args: &Args) -> impl Iterator<Item = Strength> {
    std::iter::once(Strength::Own).chain(args.rescale.iter().copied().map(Strength::RescaledTo))
}

/// A model with its unseen views.
struct Scene {
    name: String,
    model: Model,
    cameras: CameraSet,
    clean: Vec<Vec<Frame>>,
}

/// What all cases share.
pub(crate) struct Study {
    device: Device,
    clip: Clip,
    scenes: Vec<Scene>,
    origin: Origin,
}

impl Study {
    /// Opens device, checkpoint and models.
    pub(crate) fn open(args: &Args) -> Result<Self, EngineError> {
        let device =
            Device::open_with(&args.device, DeviceOptions { kernels: args.kernels, ..DeviceOptions::default() })?;
        if device.is_validated() {
            eprintln!("note: validation layers are on, so seconds are too many");
        }
        let clip = Clip::load(&device, &ClipSource::from_argument(&args.clip))?;
        let size = ImageSize::new(args.size, args.size)?;
        let scenes = args.models.iter().map(|path| Scene::open(&device, path, size)).collect::<Result<_, _>>()?;
        let info = device.info();
        let origin = Origin {
            commit: host::commit(),
            device: info.name.clone(),
            driver: info.driver.clone(),
            processor: host::processor(),
            clip: short(digest_of(&clip)),
        };
        Ok(Self { device, clip, scenes, origin })
    }

    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// A case in words.
    pub(crate) fn name(&self, args: &Args, case: Case) -> String {
        let Case { mode, target_psnr, seed, .. } = case;
        format!("{} {mode} {target_psnr} dB, {} bits, seed {seed}", self.scenes[case.model].name, args.bits)
    }

    /// Whether the ledger has this case at every strength, with a message swap if one is asked for.
    pub(crate) fn is_measured(&self, ledger: &Ledger, args: &Args, case: Case) -> bool {
        let settings = settings(&config(args, (case.mode, case.target_psnr), case.seed));
        strengths(args).all(|strength| {
            let scene = [self.origin.clip.clone(), self.scenes[case.model].name.clone()];
            let numbers = [args.bits.to_string(), case.seed.to_string(), settings.clone(), strength.to_string()];
            let wanted: Vec<_> = IDENTITY.into_iter().zip(scene.into_iter().chain(numbers)).collect();
            let swapped = |row| strength != Strength::Own || !ledger.cell(row, "swap_second").is_empty();
            ledger.find(&wanted).is_some_and(|row| !args.swap || swapped(row))
        })
    }

    /// Embeds once, and reads at every strength.
    pub(crate) fn measure(&self, args: &Args, case: Case) -> Result<Vec<Measured>, EngineError> {
        let load = host::load();
        let name = self.name(args, case);
        let scene = &self.scenes[case.model];
        let of_seed = |seed| key(args, (&self.device, &self.clip), seed);
        let (key, stranger) = (of_seed(case.seed)?, of_seed(stranger(args, case.seed))?);
        let message = key.own_message();
        let subject =
            Subject { device: &self.device, clip: &self.clip, key: &key, model: &scene.model, message: &message };
        let config = config(args, (case.mode, case.target_psnr), case.seed);

        let embedding = Embedding::prepare(subject, config.clone())?;
        let fitted = embedding.fitted().clone();
        let embedded = train(embedding, &name)?;
        let swap = |()| self.second_copy(&subject, scene, &config, (&embedded.extractor, &name));
        let mut second_copy = args.swap.then_some(()).map(swap).transpose()?;
        let witnesses = (self.others(case.model), stranger, (case.mode == ExtractorMode::Joint).then_some(fitted));
        let mut rows = Vec::new();
        for strength in strengths(args) {
            let factor = strength.factor(&embedded);
            let (evaluation, examination) = self.read(&subject, scene, (&embedded, factor), &witnesses)?;
            let (marked, psnr) = (100.0 * evaluation.marked, evaluation.psnr.mean_of_views_db.0);
            eprintln!("{name}, x{factor:.2}: {marked:.1} % at {psnr:.2} dB, clean {:.1} %", 100.0 * evaluation.clean);
            rows.push(Measured {
                origin: self.origin.clone(),
                model: scene.name.clone(),
                settings: settings(&config),
                config: config.clone(),
                rescaled_to: strength.to_string(),
                strength: factor,
                evaluation,
                examination,
                second_copy: if strength == Strength::Own { second_copy.take() } else { None },
                steps: embedded.steps,
                parts: embedded.part_seconds(),
                seconds: embedded.seconds.clone(),
                load: load.clone(),
            });
        }
        Ok(rows)
    }

    /// Clean clips of the models that a case does not mark.
    fn others(&self, marked: usize) -> Vec<OtherScene<'_>> {
        let others = self.scenes.iter().enumerate().filter(|(i, _)| *i != marked);
        others.map(|(_, s)| OtherScene { name: &s.name, clips: &s.clean }).collect()
    }

    /// Films a mark of some strength and reads it.
    fn read(
        &self,
        subject: &Subject<'_>,
        scene: &Scene,
        (embedded, strength): (&Embedded, f32),
        (others, stranger, untrained): &(Vec<OtherScene<'_>>, Key, Option<ExtractorWeights>),
    ) -> Result<(Evaluation, CrossExamination), EngineError> {
        let sh_coeffs = embedded.with_strength(&scene.model.gaussians.sh_coeffs, strength);
        let held_out = HeldOut::shoot(&self.device, &scene.model, &sh_coeffs, &scene.cameras)?;
        let extractor = &embedded.extractor;
        let evaluation = held_out.evaluate(&self.device, &self.clip, subject.key, extractor, subject.message)?;
        let witnesses = Witnesses { scenes: others, stranger, untrained: untrained.as_ref() };
        Ok((evaluation, cross_examine(subject, extractor, &held_out, &witnesses)?))
    }

    /// Another copy for the same, now frozen extractor.
    fn second_copy(
        &self,
        subject: &Subject<'_>,
        scene: &Scene,
        config: &EmbedConfig,
        (extractor, name): (&ExtractorWeights, &str),
    ) -> Result<SecondCopy, EngineError> {
        let message = swap_message(subject.message, subject.key);
        let second = Subject { message: &message, ..*subject };
        let embedding = Embedding::prepare_with(second, config.clone(), Start::Frozen(extractor))?;
        let embedded = train(embedding, &format!("{name}, swap"))?;
        let copy = HeldOut::shoot(&self.device, &scene.model, &embedded.sh_coeffs, &scene.cameras)?;
        Ok(SecondCopy { swap: read_swap(subject, extractor, &copy, &message)?, psnr: copy.psnr()? })
    }
}

/// The key of a seed, from the cache if it is there.
pub(crate) fn key(args: &Args, (device, clip): (&Device, &Clip), seed: u8) -> Result<Key, EngineError> {
    let path = args.keys.join(format!("seed{seed}-{}bits-{}.key", args.bits, short(digest_of(clip))));
    if path.exists() {
        match Key::read(&path, clip) {
            Ok(key) => return Ok(key),
            // Of an earlier version, say; the seed gives it again.
            Err(error) => eprintln!("{error}"),
        }
    }
    eprintln!("making {}", path.display());
    let secret = MasterSecret::from_bytes([seed + 1; 32]);
    let (key, _) = Key::generate(device, clip, secret, args.bits)?;
    key.write(&path, Existing::Replace)?;
    Ok(key)
}

impl Scene {
    fn open(device: &Device, path: &Path, size: ImageSize) -> Result<Self, EngineError> {
        let model = Model::open(path)?;
        let cameras = CameraSet::open(&path.join("transforms_test.json"), size)?;
        let clean = clean_clips(device, &model, &cameras)?;
        let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { name, model, cameras, clean })
    }
}

/// The seed whose key had no part in an embedding: the next one, so that the studied seeds serve one another.
fn stranger(args: &Args, seed: u8) -> u8 {
    let others = args.seeds.iter().copied().filter(|&s| s != seed);
    others.clone().find(|&s| s > seed).or_else(|| others.min()).unwrap_or((seed + 1) % u8::MAX)
}

/// Settings of an embedding in some mode and at some fidelity.
pub(crate) fn config(args: &Args, (mode, target_psnr): (ExtractorMode, f32), seed: u8) -> EmbedConfig {
    let profile = EmbedConfig::new(args.profile.profile(), mode).with_target(target_psnr);
    EmbedConfig {
        steps: args.steps.unwrap_or(profile.steps),
        views: args.clips.unwrap_or(profile.views),
        size_px: (args.size, args.size),
        seed: u64::from(seed),
        // Nobody watches.
        held_out_every: 0,
        ..profile
    }
}

/// Hash of all settings but the seed.
fn settings(config: &EmbedConfig) -> String {
    let settings = EmbedConfig { seed: 0, ..config.clone() };
    short(Digest::of(serde_json::to_string(&settings).expect("numbers and words are valid JSON").as_bytes()))
}

fn short(digest: Digest) -> String {
    digest.to_string().chars().take(SHORT_HASH).collect()
}

/// Takes all steps, with a line now and then.
pub(crate) fn train(mut embedding: Embedding<'_>, name: &str) -> Result<Embedded, EngineError> {
    let (mut right, mut steps) = (0.0, 0);
    while let Some(report) = embedding.step()? {
        right += report.bit_accuracy;
        steps += 1;
        if steps == PROGRESS {
            let psnr = -10.0 * report.mse.log10();
            let bits = 100.0 * right / steps as f32;
            eprintln!("{name}: step {}, bits {bits:.1} %, {psnr:.1} dB", embedding.step_number());
            (right, steps) = (0.0, 0);
        }
    }
    embedding.finish()
}
