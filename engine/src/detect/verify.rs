//! The first question: does a suspect carry what the owner's receipt commits to?

use super::choice::{Answer, nearest};
use super::clip_reader::ClipReader;
use super::controls::Unmarked;
use super::free_part::FreePart;
use super::opened::Opened;
use super::report::{BitReading, Choices, ClipReading, Undone, VerifyReport};
use super::request::{VerifyInputs, VerifyRequest};
use super::suspect::Suspects;
use super::with_original::{Compared, WithOriginal};
use crate::base::observer::{Observer, Unobserved};
use crate::error::EngineError;
use crate::evidence::claim::Claim;
use crate::evidence::control::Control;
use crate::evidence::judgement::{Evidence, Verdict, judge};
use crate::evidence::other_keys::OtherKeys;
use crate::locate::views::Vantage;
use crate::media::ReadOptions;
use crate::picture::undo_guess::GuessSearch;
use crate::release::dating::standing::Standing;
use crate::watermark::extractor::reader::Reader;

/// Readings of a film where there is something to compare it with: of the message alone, of the message beside the
/// original, and of the owner's chips.
const READINGS: u32 = 3;

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
        let opened = Opened::open(self)?;
        let (extractor, promised) = (opened.extractor(), opened.promised());
        let free_part = FreePart::check(self, opened.receipt(), extractor)?;
        let standing = Standing::find(self.receipt, &opened.commitment(), &inputs.dates)?;

        let reader = Reader::new(self.device, self.clip, key, extractor)?;
        let mut reader = ClipReader::new(self.device, reader, key.num_bits(), options, observer);
        let guesses = match inputs.guesses.is_auto() {
            true => GuessSearch::suited(Suspects::are_framed(&mut reader, &inputs.suspects)?).guesses(),
            false => inputs.guesses.guesses(),
        };
        let suspects = Suspects::read(&mut reader, &inputs.suspects, &guesses)?;

        let answer = nearest(&suspects, key.num_bits(), promised, &prf, opened.rule().statistic)?;
        let tried = u32::try_from(guesses.len()).unwrap_or(u32::MAX);
        let claims = self.claims.get().saturating_mul(standing.receipts());
        let with_original = self.with_original(&opened, inputs, options, claims);
        // Whether the others come about depends on the first, so that all count either way.
        let readings = if with_original.is_some() { READINGS } else { 1 };
        let chosen = [tried, claims, readings];
        let chosen = chosen.into_iter().fold(extractor.key_rotation.of, u32::saturating_mul);
        let mut compared = match &with_original {
            Some(with_original) => with_original.read(&inputs.filmed, &mut reader)?,
            None => Compared::default(),
        };

        let own = self.cache.own_clips(self.device)?;
        let unmarked = Unmarked { unrelated: &inputs.unrelated, clean: &inputs.clean, own: &own };
        let mut controls = unmarked.read(&mut reader, answer.message())?;
        let features = &suspects.features()[answer.guess()].features;
        for other in &inputs.other_keys {
            controls.push(other.read(self.device, key, extractor, features)?);
        }

        let evidence = self.weigh(&opened, &suspects, &answer, chosen, &controls)?;
        let may_locate = inputs.filmed.is_empty() && evidence.verdict != Verdict::Present;
        if let Some(with_original) = with_original.filter(|_| may_locate) {
            compared = with_original.locate(&inputs.locatable, Vantage::of(&inputs.near), &mut reader)?;
        }
        let code = promised.id().map(|id| id.code());
        let alone = |clip| ClipReading::of(clip, answer.guess(), &answer.message(), code, &prf);
        let verdict = if compared.proves() { Verdict::Present } else { evidence.verdict };
        Ok(VerifyReport {
            verdict,
            evidence,
            compared_message: compared.message,
            owner_chips: compared.chips,
            located: compared.located,
            commitment: opened.commitment(),
            schema: opened.receipt().schema,
            free_part,
            choices: Choices::of(self, inputs, options),
            standing,
            key_rotation: extractor.key_rotation,
            undone: (tried > 1).then(|| Undone { guess: guesses[answer.guess()], tried }),
            id: answer.id_evidence(promised, chosen, extractor.mode),
            clips: suspects.clips().iter().map(alone).collect::<Result<_, _>>()?,
            frames: suspects.frames(),
            damage: suspects.damage().to_vec(),
            bits: BitReading::all(&answer.message(), answer.reading()),
            promise: opened.receipt().body.promise.clone(),
            exhibits: suspects.into_exhibits(),
        })
    }

    /// What compares films with the original, where there is one, films that it may be found in, and something to read.
    fn with_original<'a>(
        &'a self,
        opened: &'a Opened,
        inputs: &VerifyInputs,
        options: &'a ReadOptions,
        claims: u32,
    ) -> Option<WithOriginal<'a>> {
        let original = self.original.filter(|_| !(inputs.filmed.is_empty() && inputs.locatable.is_empty()))?;
        // What the owner gives away of a receipt may be without its settings; and a joint extractor proves nothing.
        let config = opened.receipt().config(self.receipt).ok();
        let views = config.filter(|_| opened.extractor().mode.is_message_blind()).map(|config| config.views);
        let chips = opened.receipt().body.promise.owner_chips;
        let claims = claims.saturating_mul(READINGS);
        let with_original = WithOriginal { request: self, opened, original, options, claims, views, chips };
        Some(with_original).filter(WithOriginal::has_anything_to_read)
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
            objections: opened.objections(),
        };
        judge(&claim, opened.rule())
    }
}
