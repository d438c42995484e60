//! What an accuser could do: fit an extractor afterwards, so that a clip without a mark says a message.
//!
//! The accuser has somebody's clip, a key of his own, and all the time he wants. He trains R as `joint` does, but on
//! clips that carry nothing, and calls them marked. What stands against it:
//!
//! - An extractor of mode `joint` has no p-value. Its controls read clips that carry nothing, and say the same.
//! - A file that calls such an extractor `blind`, `pretrained` or `none` is refused, for it holds a trained network:
//!   [`ExtractorWeights::read`].
//! - It is not the extractor that a receipt from before commits to: the receipt has its hash.
//!
//! What no file can refute is a receipt that the accuser seals *afterwards*, with a key of his own, over an extractor
//! that calls itself `blind` and whose calibration he chose to suit the clip: a calibration follows from the asset,
//! which whoever verifies need not have. A p-value is a statement about a message that was fixed before the clip was
//! there to be looked at. That the commitment was, only a timestamp can show that somebody else gave it, and the older
//! one wins.

use std::sync::Arc;
use std::time::Instant;

use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::control::ChanceDeviation;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::media::Frame;
use guard4d_engine::networks::clip::TowerPurpose;
use guard4d_engine::picture::known_views::KnownViews;
use guard4d_engine::picture::undo_guess::UndoGuess;
use guard4d_engine::release::evaluate::{chance_deviation, read_clips};
use guard4d_engine::watermark::embed::Subject;
use guard4d_engine::watermark::extractor::features::{FeatureExtractor, Training};
use guard4d_engine::watermark::extractor::preprocess::Preprocessor;
use guard4d_engine::watermark::extractor::reader::Reader;
use guard4d_engine::watermark::extractor::weights::{CLIP_FRAMES, ExtractorWeights};
use guard4d_engine::watermark::key::decoder::{Decoder, DecoderPass};
use guard4d_kernels::loss::bce::{self, Answers, Groups, Objective};
use guard4d_kernels::optim::adam::AdamConfig;
use guard4d_kernels::{Buffer, Device};
use serde::Serialize;

/// How hard an accuser tries.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ForgeConfig {
    /// Training steps, one clip each.
    pub steps: usize,
    /// Adam's rate for R.
    pub lr: f32,
    /// Logit beyond which a bit is left alone, as in an embedding.
    pub margin: f32,
}

impl Default for ForgeConfig {
    fn default() -> Self {
        Self { steps: 300, lr: 3e-3, margin: 6.0 }
    }
}

/// An extractor that was made to say a message.
#[derive(Clone, Debug)]
pub struct Forgery {
    /// It; of mode `joint`, which is what it is.
    pub extractor: ExtractorWeights,
    /// Bits of the message that the clips said before.
    pub before: ChanceDeviation,
    /// Bits of the message that it makes the clips say.
    pub said: ChanceDeviation,
    /// Seconds that it took.
    pub seconds: f64,
}

/// Trains R of `start` until unmarked `clips` say the subject's message; CLIP, decoder and calibration stay as they
/// are.
///
/// `start` is what [`guard4d_engine::watermark::embed::Embedding::fitted`] has for `joint`, or any other extractor with
/// a network. The clips are 8-bit frames of an asset that carries nothing; the subject's model is not looked at.
///
/// # Errors
/// [`EngineError::Usage`] without a network to train, without a step or a clip, or when key, checkpoint and message do
/// not fit; [`EngineError::NotFinite`] when training goes astray; when the device fails.
pub fn forge(
    subject: &Subject<'_>,
    start: &ExtractorWeights,
    clips: &[Vec<Frame>],
    config: &ForgeConfig,
) -> Result<Forgery, EngineError> {
    let started = Instant::now();
    check(start, clips, config)?;
    let Subject { device, clip, key, message, .. } = *subject;
    let said = |extractor: &ExtractorWeights| {
        chance_deviation(&read_clips(&mut Reader::new(device, clip, key, extractor)?, clips, key.bits())?, message)
    };
    let before = said(start)?;
    let mut accuser = Accuser::new(subject, start)?;
    let shown = accuser.show(device, clips)?;
    for step in 0..config.steps {
        let loss = accuser.step(device, &shown[step % shown.len()], config)?;
        if !loss.is_finite() {
            return Err(EngineError::NotFinite { what: format!("loss at step {step}"), got: f64::from(loss) });
        }
    }
    let tmsd = accuser.features.tmsd().map(|tmsd| tmsd.weights()).transpose()?;
    let extractor = ExtractorWeights { mode: ExtractorMode::Joint, tmsd, ..start.clone() };
    Ok(Forgery { before, said: said(&extractor)?, extractor, seconds: started.elapsed().as_secs_f64() })
}

fn check(start: &ExtractorWeights, clips: &[Vec<Frame>], config: &ForgeConfig) -> Result<(), EngineError> {
    let usage = |what: &str, got: &str, expected: &str| {
        Err(EngineError::Usage { what: what.to_owned(), got: got.to_owned(), expected: expected.to_owned() })
    };
    if start.tmsd.as_ref().is_none_or(|tmsd| tmsd.layers.is_empty()) {
        return usage("extractor to forge with", "no network", "one with a network, as `joint` has");
    }
    if clips.iter().all(Vec::is_empty) || config.steps == 0 {
        return usage("forgery", "no frame or no step", "at least one of each");
    }
    let rates = [config.lr, config.margin];
    if rates.iter().any(|v| !(v.is_finite() && *v >= 0.0)) {
        return usage("forgery", &format!("rate and margin {rates:?}"), "numbers of 0 or more");
    }
    Ok(())
}

/// R in training, and what it is judged by.
struct Accuser {
    features: FeatureExtractor,
    decoder: Decoder,
    pass: DecoderPass,
    target: Buffer<f32>,
    value: Buffer<f32>,
    groups: Groups,
    known_views: Option<Arc<KnownViews>>,
}

impl Accuser {
    fn new(subject: &Subject<'_>, start: &ExtractorWeights) -> Result<Self, EngineError> {
        let Subject { device, clip, key, message, .. } = *subject;
        let decoder = Decoder::new(device, &start.calibration.fold(&key.decoder, &key.codes, &key.text_mean))?;
        Ok(Self {
            features: FeatureExtractor::new(device, clip, start.tmsd.as_ref(), 1, TowerPurpose::InputGradient)?,
            pass: decoder.pass(device, CLIP_FRAMES)?,
            decoder,
            target: device.buffer_from("forgery.target", &target(message))?,
            value: device.buffer("forgery.value", 1)?,
            groups: Groups { groups: 1, rows: CLIP_FRAMES, bits: key.bits() },
            known_views: start.known_views.clone(),
        })
    }

    /// The clips at CLIP's size, in pieces of [`CLIP_FRAMES`] frames.
    fn show(&self, device: &Device, clips: &[Vec<Frame>]) -> Result<Vec<Buffer<f32>>, EngineError> {
        let mut shown = Vec::new();
        for clip in clips.iter().filter(|clip| !clip.is_empty()) {
            let mut preprocessor = Preprocessor::new(device, &clip[0], self.features.shape())?;
            let parts = self.known_views.as_ref().map(|views| views.parts(clip)).unwrap_or_default();
            for (number, chunk) in clip.chunks(CLIP_FRAMES).enumerate() {
                let mut resized = device.buffer("forgery.resized", self.features.clip_len())?;
                preprocessor.load(chunk)?;
                preprocessor.cut(parts.get(number * CLIP_FRAMES..).unwrap_or_default())?;
                let mut rec = device.recorder()?;
                preprocessor.show(&mut rec, UndoGuess::NONE, &mut resized)?;
                rec.submit()?;
                shown.push(resized);
            }
        }
        Ok(shown)
    }

    /// One step on one clip; returns its loss before the update.
    fn step(&mut self, device: &Device, clip: &Buffer<f32>, config: &ForgeConfig) -> Result<f32, EngineError> {
        let objective = Objective::Margin { margin: config.margin };
        let mut rec = device.recorder()?;
        self.features.forward(&mut rec, &[clip])?;
        self.decoder.forward(&mut rec, self.features.features(), &mut self.pass)?;
        let answers = Answers { groups: self.groups, logits: &self.pass.logits, target: &self.target };
        bce::forward(&mut rec, objective, &answers, &mut self.value)?;
        bce::backward(&mut rec, objective, 1.0, &answers, &self.value, &mut self.pass.v_logits)?;
        self.decoder.backward(&mut rec, &mut self.pass)?;
        self.features.backward(&mut rec, &self.pass.v_features, Training::Tmsd)?;
        if let Some(tmsd) = self.features.tmsd() {
            tmsd.step(&mut rec, &AdamConfig { lr: config.lr, ..AdamConfig::default() })?;
        }
        rec.submit()?;
        Ok(objective.loss(self.value.read()?[0]))
    }
}

/// Bits as a loss takes them.
fn target(message: &Message) -> Vec<f32> {
    message.bits().map(|bit| f32::from(u8::from(bit))).collect()
}
