//! The owner's chips in films whose cameras are known: a second reading, beside the message, that needs the original.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::PoisonError;

use serde::Serialize;

use super::gathered::{KnownFilm, SharedClaim, gather};
use super::opened::Opened;
use super::request::VerifyRequest;
use super::suspect::FilmedSuspect;
use crate::base::observer::{Observer, Progress};
use crate::error::EngineError;
use crate::fingerprint::issue::Issue;
use crate::locate::finding::{DEFAULT_FRAMES, Finding, LocateReport, Locating};
use crate::media::framing::Framing;
use crate::media::{FrameSource, ReadOptions};

/// Readings that a verification has where it reads chips too: of the message, and of these.
pub(super) const READINGS: u32 = 2;

/// What the chips say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChipsReading {
    /// How well they agree with the key's.
    #[serde(flatten)]
    pub claim: SharedClaim,
    /// Frames that were compared with the original.
    pub frames: u64,
    /// What p-values are multiplied by: the claims that this one was chosen from, and the readings.
    pub searched: u32,
    /// Whether they alone prove it by the receipt's rule.
    pub proves: bool,
}

impl ChipsReading {
    /// Decimal logarithm of the bound on the p-value, times what it was chosen from.
    #[must_use]
    pub fn log10_p_searched(&self) -> f64 {
        self.claim.log10_p + f64::from(self.searched).log10()
    }
}

/// Films that were located, and what is said of that.
#[derive(Debug, Default)]
pub(super) struct Located {
    pub(super) films: Vec<FilmedSuspect>,
    pub(super) reports: Vec<LocateReport>,
}

/// What is read, by whom.
pub(super) struct ChipsReader<'a> {
    pub(super) request: &'a VerifyRequest<'a>,
    pub(super) opened: &'a Opened,
    /// Which frames are read.
    pub(super) options: &'a ReadOptions,
    /// What the claim was chosen from.
    pub(super) claims: u32,
}

impl ChipsReader<'_> {
    /// Whether there is something to read in films, once their cameras are known.
    pub(super) fn is_promised(&self) -> bool {
        self.request.original.is_some() && self.opened.receipt().body.promise.owner_chips.is_some()
    }

    /// Looks for the cameras of films; those in which the original was not found are left out.
    ///
    /// # Errors
    /// Those of reading films, of the device and of `observer`.
    pub(super) fn locate(&self, films: &[PathBuf], observer: &mut dyn Observer) -> Result<Located, EngineError> {
        let mut located = Located::default();
        let Some(original) = self.request.original.filter(|_| self.is_promised()) else { return Ok(located) };
        let shared = self.request.cache.locator(self.request.device, original)?;
        let mut locator = shared.lock().unwrap_or_else(PoisonError::into_inner);
        for path in films {
            // Every frame that the message is read in, up to as many as are enough.
            let options = ReadOptions { framing: Framing::default(), ..self.options.clone() };
            let most = NonZeroU32::new(DEFAULT_FRAMES).unwrap_or(NonZeroU32::MIN);
            let Finding { cameras, report } = locator.film(path, &options, most, observer)?;
            let cameras = cameras.filter(|_| report.verdict == Locating::Located);
            located.films.extend(cameras.map(|cameras| FilmedSuspect { path: path.clone(), cameras }));
            located.reports.push(report);
        }
        Ok(located)
    }

    /// Compares films with the original; none without films, without the original, or where no chips were written.
    ///
    /// # Errors
    /// Those of reading films, of the device and of `observer`.
    pub(super) fn read(
        &self,
        films: &[FilmedSuspect],
        observer: &mut dyn Observer,
    ) -> Result<Option<ChipsReading>, EngineError> {
        let Self { request, opened, options, claims } = self;
        let promise = &opened.receipt().body.promise;
        let (Some(original), Some(chips), [_, ..]) = (request.original, promise.owner_chips, films) else {
            return Ok(None);
        };
        let issue = Issue::of_owner(original, request.key.prf(), chips.strength);
        // Cameras are those of whole frames.
        let options = ReadOptions { framing: Framing::default(), ..(*options).clone() };
        let open = |film: &FilmedSuspect| FrameSource::open(&film.path, &options);
        let sources = films.iter().map(open).collect::<Result<Vec<_>, _>>()?;
        let known = films.iter().zip(&sources).map(|(film, source)| KnownFilm::new(&film.path, source, &film.cameras));
        let known = known.collect::<Result<Vec<_>, _>>()?;
        let total = Some(known.iter().map(|film| film.shots.len() as u64).sum());
        let mut done = 0;
        let gathered = gather(request.device, &issue, &known, &mut || {
            done += 1;
            observer.observe(Progress { stage: "the owner's chips", done, total })
        })?;
        let claim = gathered.shared(&issue)?;
        let searched = claims.saturating_mul(READINGS);
        let rule = opened.rule();
        let reading = ChipsReading { claim, frames: gathered.frames, searched, proves: false };
        let proves = reading.log10_p_searched() + f64::from(rule.num_claims).log10() <= rule.fpr.log10();
        Ok(Some(ChipsReading { proves, ..reading }))
    }
}
