//! The first question: does a suspect carry what the owner's receipt commits to?

use std::path::{Path, PathBuf};

use guard4d_kernels::Device;

use super::choice::{Answer, nearest};
use super::clip_reader::ClipReader;
use super::controls::{OtherKey, read_unmarked};
use super::opened::Opened;
use super::report::{ClipReading, Undone, VerifyReport};
use super::sought::Sought;
use super::suspect::{Suspect, Suspects};
use crate::base::observer::{Observer, Unobserved};
use crate::error::EngineError;
use crate::evidence::claim::Claim;
use crate::evidence::control::Control;
use crate::evidence::judgement::{Evidence, judge};
use crate::evidence::other_keys::OtherKeys;
use crate::media::{Frame, ReadOptions};
use crate::networks::clip::ClipModel;
use crate::picture::undo_guess::GuessSearch;
use crate::release::dating::standing::{DateFiles, Standing};
use crate::watermark::extractor::pretrained::PretrainedExtractor;
use crate::watermark::extractor::reader::Reader;
use crate::watermark::key::owner_key::Key;

/// What is verified, by whom.
#[derive(Clone, Copy, Debug)]
pub struct VerifyRequest<'a> {
    /// Device.
    pub device: &'a Device,
    /// Frozen CLIP.
    pub clip: &'a ClipModel,
    /// Owner key.
    pub key: &'a Key,
    /// What the clips are asked for; by default what the receipt says: whichever id fits best if it is for an id, else
    /// the key's own message.
    pub sought: Option<Sought>,
    /// Receipt of the embedding; the extractor lies beside it.
    pub receipt: &'a Path,
    /// What an extractor that calls itself pretrained has to look along; the built-in one unless it is given.
    pub pretrained: Option<&'a PretrainedExtractor>,
}

/// Clips to read and clips to compare with.
#[derive(Debug, Default)]
pub struct VerifyInputs {
    /// What is under suspicion.
    pub suspects: Vec<Suspect>,
    /// What may have been done to all of it alike, and is undone where that brings it nearer to the claim.
    pub guesses: GuessSearch,
    /// Videos that surely carry no mark.
    pub unrelated: Vec<PathBuf>,
    /// Frames of the unmarked asset, one list per clip.
    pub clean: Vec<Vec<Frame>>,
    /// Keys that had no part in the embedding.
    pub other_keys: Vec<OtherKey>,
    /// What dates the receipt.
    pub dates: DateFiles,
}

impl VerifyRequest<'_> {
    /// Reads all clips and weighs them. All suspect clips count as one: their frames share their bias.
    ///
    /// Frames are read as they are decoded, so that videos of any length take the same memory but for their features.
    /// The framing of `options` is for suspect videos alone, as that is where a picture can have been framed anew.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when receipt, key, message, extractor, date or a clip do not fit; when the device
    /// fails.
    pub fn verify(&self, inputs: &VerifyInputs, options: &ReadOptions) -> Result<VerifyReport, EngineError> {
        self.verify_observed(inputs, options, &mut Unobserved)
    }

    /// [`Self::verify`], which tells `observer` of every frame of a suspect or unrelated clip.
    ///
    /// # Errors
    /// Those of [`Self::verify`] and of `observer`.
    pub fn verify_observed(
        &self,
        inputs: &VerifyInputs,
        options: &ReadOptions,
        observer: &mut dyn Observer,
    ) -> Result<VerifyReport, EngineError> {
        let (key, prf) = (self.key, self.key.prf());
        let opened = Opened::open(self.receipt, key, self.sought, self.pretrained)?;
        let (extractor, promised) = (opened.extractor(), opened.promised());
        let standing = Standing::find(self.receipt, &opened.commitment(), &inputs.dates)?;

        let reader = Reader::new(self.device, self.clip, key, extractor)?;
        let mut reader = ClipReader::new(self.device, reader, key.num_bits(), options, observer);
        let guesses = inputs.guesses.guesses();
        let suspects = Suspects::read(&mut reader, &inputs.suspects, &guesses)?;

        let answer = nearest(&suspects, key.num_bits(), promised, &prf, opened.rule().statistic)?;
        let tried = u32::try_from(guesses.len()).unwrap_or(u32::MAX);
        let chosen = extractor.key_rotation.of.saturating_mul(tried).saturating_mul(standing.receipts());

        let mut controls = read_unmarked(&mut reader, &inputs.unrelated, &inputs.clean, answer.message())?;
        let features = &suspects.features()[answer.guess()].features;
        for other in &inputs.other_keys {
            controls.push(other.read(self.device, key, extractor, features)?);
        }

        let evidence = self.weigh(&opened, &suspects, &answer, chosen, &controls)?;
        let code = promised.id().map(|id| id.code());
        let alone = |clip| ClipReading::of(clip, answer.guess(), &answer.message(), code, &prf);
        Ok(VerifyReport {
            evidence,
            commitment: opened.commitment(),
            standing,
            key_rotation: extractor.key_rotation,
            undone: (tried > 1).then(|| Undone { guess: guesses[answer.guess()], tried }),
            id: answer.id_evidence(promised, chosen, extractor.mode),
            clips: suspects.clips().iter().map(alone).collect::<Result<_, _>>()?,
            frames: suspects.frames(),
            damage: suspects.damage().to_vec(),
        })
    }

    /// Judges the answer beside other keys' and the controls; `chosen` is what it was chosen from, but for ids.
    fn weigh(
        &self,
        opened: &Opened,
        suspects: &Suspects,
        answer: &Answer,
        chosen: u32,
        controls: &[Control],
    ) -> Result<Evidence, EngineError> {
        let extractor = opened.extractor();
        let coordinates = extractor.calibration.coordinates(&suspects.features()[answer.guess()].features);
        let claim = Claim {
            message: answer.message(),
            searched: answer.searched(opened.promised(), chosen),
            mode: extractor.mode,
            reading: answer.reading(),
            other_keys: &OtherKeys::derive(&self.key.prf(), &coordinates)?,
            side_px: suspects.side_px(),
            controls,
        };
        judge(&claim, opened.rule())
    }
}
