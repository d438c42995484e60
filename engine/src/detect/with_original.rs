//! Films against the original, from where they were taken: what the owner's chips say, and what the message does.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::PoisonError;

use super::choice::Answer;
use super::clip_reader::ClipReader;
use super::compared_message::ComparedMessage;
use super::comparer::Comparer;
use super::gathered::{KnownFilm, gather};
use super::opened::Opened;
use super::owner_chips::ChipsReading;
use super::request::VerifyRequest;
use super::suspect::FilmedSuspect;
use crate::base::observer::{Observer, Progress};
use crate::error::EngineError;
use crate::evidence::id_code::SearchedP;
use crate::evidence::reading::Reading;
use crate::fingerprint::issue::Issue;
use crate::locate::finding::{DEFAULT_FRAMES, Finding, LocateReport, Locating, Wanted};
use crate::locate::views::Vantage;
use crate::media::framing::Framing;
use crate::media::{FrameSource, ReadOptions};
use crate::release::receipt::OwnerChips;
use crate::scene::Model;
use crate::watermark::embed::TrainingViews;

/// Both readings beside the first.
#[derive(Debug, Default)]
pub(super) struct Compared {
    pub(super) message: Option<ComparedMessage>,
    pub(super) chips: Option<ChipsReading>,
    /// How the cameras of films were found, where they were looked for.
    pub(super) located: Vec<LocateReport>,
}

impl Compared {
    /// Whether either proves it.
    pub(super) fn proves(&self) -> bool {
        self.message.as_ref().is_some_and(|message| message.proves) || self.chips.is_some_and(|chips| chips.proves)
    }
}

/// What is read, by whom.
pub(super) struct WithOriginal<'a> {
    pub(super) request: &'a VerifyRequest<'a>,
    pub(super) opened: &'a Opened,
    pub(super) original: &'a Model,
    /// Which frames are read.
    pub(super) options: &'a ReadOptions,
    /// What the claim was chosen from: claims, and readings of this film.
    pub(super) claims: u32,
    /// How training looked at the asset, where the receipt says it and the message may prove something.
    pub(super) views: Option<TrainingViews>,
    /// The owner's chips, where they were written.
    pub(super) chips: Option<OwnerChips>,
}

impl WithOriginal<'_> {
    /// Whether films say anything once their cameras are known.
    pub(super) fn has_anything_to_read(&self) -> bool {
        self.views.is_some() || self.chips.is_some()
    }

    /// Looks for the cameras of films, and compares those in which the original was found.
    ///
    /// # Errors
    /// Those of reading films, of the device and of the observer.
    pub(super) fn locate(
        &self,
        films: &[PathBuf],
        vantage: Vantage<'_>,
        reader: &mut ClipReader<'_>,
    ) -> Result<Compared, EngineError> {
        let (mut found, mut located) = (Vec::new(), Vec::new());
        let shared = self.request.cache.locator(self.request.device, self.original, vantage)?;
        let mut locator = shared.lock().unwrap_or_else(PoisonError::into_inner);
        for path in films {
            // Every frame that the message is read in, up to as many as are enough.
            let most = NonZeroU32::new(DEFAULT_FRAMES).unwrap_or(NonZeroU32::MIN);
            let options = self.whole_frames();
            let wanted = Wanted { model: self.original, path, options: &options, most };
            let Finding { cameras, report } = locator.film(wanted, None, reader.observer())?;
            let cameras = cameras.filter(|_| report.verdict == Locating::Located);
            found.extend(cameras.map(|cameras| FilmedSuspect { path: path.clone(), cameras }));
            located.push(report);
        }
        Ok(Compared { located, ..self.read(&found, reader)? })
    }

    /// Compares films with the original; nothing without films.
    ///
    /// # Errors
    /// Those of reading films, of the device and of the observer.
    pub(super) fn read(&self, films: &[FilmedSuspect], reader: &mut ClipReader<'_>) -> Result<Compared, EngineError> {
        if films.is_empty() {
            return Ok(Compared::default());
        }
        let open = |film: &FilmedSuspect| FrameSource::open(&film.path, &self.whole_frames());
        let sources = films.iter().map(open).collect::<Result<Vec<_>, _>>()?;
        let known = films.iter().zip(&sources).map(|(film, source)| KnownFilm::new(&film.path, source, &film.cameras));
        let known = known.collect::<Result<Vec<_>, _>>()?;
        Ok(Compared {
            message: self.message(&known, reader)?,
            chips: self.chips(&known, reader.observer())?,
            located: Vec::new(),
        })
    }

    /// The message; none where it is not known how training looked at the asset, or no frame's camera is.
    fn message(
        &self,
        films: &[KnownFilm<'_>],
        reader: &mut ClipReader<'_>,
    ) -> Result<Option<ComparedMessage>, EngineError> {
        let Self { request, opened, original, claims, ref views, .. } = *self;
        let Some(views) = views else { return Ok(None) };
        let chosen = claims.saturating_mul(opened.extractor().key_rotation.of);
        let mut comparer = Comparer::new(request.device, original, views)?;
        for film in films {
            reader.compare(film, &mut comparer)?;
        }
        let logits = comparer.into_logits();
        if logits.is_empty() {
            return Ok(None);
        }
        let reading = Reading::from_logits(&logits, request.key.num_bits())?;
        let promised = opened.promised();
        let answer = Answer::of(0, reading, promised, &request.key.prf())?;
        let p_value = SearchedP::of(answer.reading(), &answer.message(), answer.searched(promised, chosen))?;
        let frames = answer.reading().num_frames();
        let id = answer.id_evidence(promised, chosen, opened.extractor().mode).map(|id| id.found.id);
        let rule = opened.rule();
        let proves = opened.objections().is_empty()
            && frames >= rule.min_frames
            && p_value.by(rule.statistic) * f64::from(rule.num_claims) <= rule.fpr;
        let matches = answer.reading().matches(&answer.message())?;
        let num_bits = answer.message().num_bits();
        Ok(Some(ComparedMessage { matches, num_bits, frames, id, p_value, proves }))
    }

    /// The owner's chips; none where none were written.
    fn chips(&self, films: &[KnownFilm<'_>], observer: &mut dyn Observer) -> Result<Option<ChipsReading>, EngineError> {
        let Self { request, opened, original, claims, chips, .. } = *self;
        let Some(chips) = chips else { return Ok(None) };
        let issue = Issue::of_owner(original, request.key.prf(), chips.strength);
        let total = Some(films.iter().map(|film| film.shots.len() as u64).sum());
        let mut done = 0;
        let gathered = gather(request.device, &issue, films, &mut || {
            done += 1;
            observer.observe(Progress { stage: "the owner's chips", done, total })
        })?;
        Ok(Some(ChipsReading::of(&gathered, &issue, claims, opened.rule())?))
    }

    /// Cameras are those of whole frames.
    fn whole_frames(&self) -> ReadOptions {
        ReadOptions { framing: Framing::default(), ..self.options.clone() }
    }
}
