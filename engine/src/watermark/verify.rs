//! Reading a mark from video, with the evidence for and against it.

use std::path::{Path, PathBuf};

use guard4d_kernels::Device;

use super::delivery::EXTRACTOR;
use super::evidence::{Claim, Evidence, judge};
use super::extractor::{ExtractorWeights, Reader, Sight, decode};
use super::key::Key;
use super::message::Message;
use super::null_panel::{Control, ControlKind};
use super::other_keys::ThrowawayKeys;
use super::reading::Reading;
use super::receipt::Receipt;
use crate::clip::Clip;
use crate::error::EngineError;
use crate::media::{self, Frame, Integrity, ReadOptions};
use crate::render::Film;
use crate::scene::{CameraSet, Model};

/// What is verified against what.
#[derive(Debug)]
pub struct Case<'a> {
    /// Device.
    pub device: &'a Device,
    /// Frozen CLIP.
    pub clip: &'a Clip,
    /// Owner key.
    pub key: &'a Key,
    /// The message claimed.
    pub message: Message,
    /// Receipt of the embedding; the extractor lies beside it.
    pub receipt: &'a Path,
}

/// Clips to read and clips to compare with.
#[derive(Debug, Default)]
pub struct Exhibits {
    /// Suspect clips: PNG folders or videos.
    pub suspects: Vec<PathBuf>,
    /// Clips that surely carry no mark.
    pub unrelated: Vec<PathBuf>,
    /// Frames of the unmarked asset, one list per clip.
    pub clean: Vec<Vec<Frame>>,
    /// Keys that had no part in the embedding.
    pub strangers: Vec<Stranger>,
}

/// Somebody else's key.
#[derive(Debug)]
pub struct Stranger {
    /// For the report.
    pub name: String,
    /// As long as the owner's, and made with the same checkpoint.
    pub key: Key,
}

/// The evidence, with what went into it.
#[derive(Debug, serde::Serialize)]
pub struct Report {
    /// Verdict, p-value, null panel.
    pub evidence: Evidence,
    /// Frames read.
    pub frames: usize,
    /// What the decoder of a damaged video said.
    pub damage: Vec<String>,
}

impl Case<'_> {
    /// Reads all clips and weighs them. All suspect clips count as one: their frames share their bias.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when receipt, key, message, extractor or a clip do not fit; when the device fails.
    pub fn verify(&self, exhibits: &Exhibits, options: &ReadOptions) -> Result<Report, EngineError> {
        let receipt = Receipt::read(self.receipt)?;
        receipt.verify_commitment(self.receipt)?;
        let extractor = self.extractor(&receipt)?;
        let mut reader = Reader::new(self.device, self.clip, self.key, &extractor)?;
        let mut damage = Vec::new();
        let (mut sight, mut side, mut frames) = (Sight::default(), u32::MAX, 0);
        for path in &exhibits.suspects {
            let clip = media::read_clip(path, options)?;
            if let Integrity::Damaged { messages } = clip.integrity() {
                damage.push(format!("{}: {messages}", path.display()));
            }
            let (width, height) = clip.size_px();
            side = side.min(width).min(height);
            frames += clip.frames().len();
            sight.extend(&reader.look(clip.frames())?);
        }
        let bits = self.message.num_bits();
        let mut controls = Vec::new();
        for path in &exhibits.unrelated {
            let clip = media::read_clip(path, options)?;
            let reading = Reading::from_logits(&reader.logits(clip.frames())?, bits)?;
            controls.push(self.control(ControlKind::UnrelatedClip, path.display().to_string(), reading));
        }
        for (i, clean) in exhibits.clean.iter().enumerate() {
            let reading = Reading::from_logits(&reader.logits(clean)?, bits)?;
            controls.push(self.control(ControlKind::CleanRender, format!("clean view {i}"), reading));
        }
        for stranger in &exhibits.strangers {
            controls.push(self.stranger(stranger, &extractor, &sight)?);
        }
        let reading = Reading::from_logits(&sight.logits, bits)?;
        let claim = Claim {
            message: self.message,
            mode: extractor.mode,
            reading: &reading,
            throwaway: &ThrowawayKeys::derive(&self.key.prf(), &extractor.calibration.coordinates(&sight.features))?,
            side_px: side,
            controls: &controls,
        };
        let evidence = judge(&claim, &receipt.body.promise.thresholds)?;
        Ok(Report { evidence, frames, damage })
    }

    /// The suspect clips read with another trained key, for the message that key would embed.
    fn stranger(
        &self,
        stranger: &Stranger,
        extractor: &ExtractorWeights,
        sight: &Sight,
    ) -> Result<Control, EngineError> {
        let Stranger { name, key } = stranger;
        let bits = self.message.num_bits();
        let usage = |got: &str, expected: String| {
            Err(EngineError::Usage { what: format!("other key {name}"), got: got.to_owned(), expected })
        };
        if key.bits() != self.key.bits() {
            return usage(&format!("{} bits", key.bits()), format!("{bits} bits like the owner's"));
        }
        if key.prf().key_id() == self.key.prf().key_id() {
            return usage("the owner's key", "a key that had no part in the embedding".to_owned());
        }
        let logits = decode(self.device, key, &extractor.calibration, &sight.features)?;
        Ok(Control {
            kind: ControlKind::OtherKey,
            name: name.clone(),
            reading: Reading::from_logits(&logits, bits)?,
            message: key.own_message(),
        })
    }

    /// The extractor beside the receipt, after checking that receipt, key, message and extractor belong together.
    fn extractor(&self, receipt: &Receipt) -> Result<ExtractorWeights, EngineError> {
        let promise = &receipt.body.promise;
        let prf = self.key.prf();
        let bad = |path: &Path, field: &str, got: String, expected: String| EngineError::BadData {
            path: path.to_owned(),
            field: field.to_owned(),
            got,
            expected,
        };
        if promise.key_id != prf.key_id() {
            let (got, expected) = (promise.key_id.to_string(), prf.key_id().to_string());
            return Err(bad(self.receipt, "key_id", got, format!("{expected}, the key given")));
        }
        let committed = [
            ("token_table", promise.token_table, self.key.table.digest()),
            ("decoder", promise.decoder, self.key.decoder_digest()),
            ("clip", promise.clip, self.key.clip),
        ];
        for (field, promised, given) in committed {
            if promised != given {
                return Err(bad(self.receipt, field, promised.to_string(), format!("{given}, as in the key given")));
            }
        }
        if !receipt.commits_to(&self.message, &prf) {
            let got = "a commitment to another message".to_owned();
            return Err(bad(self.receipt, "message_mac", got, "one to the message given with --message".to_owned()));
        }
        let path = self.receipt.with_file_name(EXTRACTOR);
        let extractor = ExtractorWeights::read(&path, self.key)?;
        let digest = extractor.digest(self.key)?;
        if promise.extractor != Some(digest) {
            let expected = promise.extractor.map_or_else(|| "none".to_owned(), |d| d.to_string());
            return Err(bad(&path, "hash", digest.to_string(), format!("{expected}, as committed in the receipt")));
        }
        Ok(extractor)
    }

    fn control(&self, kind: ControlKind, name: String, reading: Reading) -> Control {
        Control { kind, name, reading, message: self.message }
    }
}

/// 8-bit frames of an unmarked model, one list per clip.
///
/// # Errors
/// When the device fails.
pub fn clean_clips(device: &Device, model: &Model, cameras: &CameraSet) -> Result<Vec<Vec<Frame>>, EngineError> {
    let shots = cameras.clips();
    let mut clips = vec![Vec::new(); shots.len()];
    let mut film = Film::new(device, &model.gaussians, model.deformation.as_ref(), model.background)?;
    film.shoot(&shots, |number, camera, pixels| {
        clips[number].push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
        Ok(())
    })?;
    Ok(clips)
}
