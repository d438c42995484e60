//! The frames of a film, shot by shot.

use std::ops::Range;

use guard4d_kernels::Device;

use super::align::{Fit, align, moments};
use super::bank::{Bank, Edges};
use super::making::draw_as;
use super::picture::Picture;
use super::pose::Pose;
use super::search::{NEAR, NEXT, SCANNED, TELL, anywhere};
use super::settle::settle;
use super::shots::{both_ways, is_same, shots};
use super::so_far::{Begun, Exactly, First, SoFar};
use super::stage::Stage;
use super::views::Vantage;
use super::work::Work;
use crate::base::digest::Digest;
use crate::base::numbers::median;
use crate::base::observer::Observer;
use crate::base::spread::spread;
use crate::error::EngineError;
use crate::render::making::Making;
use crate::scene::Model;

/// Likeness from which on what a search comes to is followed through its shot.
const FOUND: f64 = 0.6;
/// Likeness at which a shot is found: its frames', at the median, drawn as it was made. Films of the asset have 0.77
/// and more, screens and patterns behind it included.
const KNOWN: f64 = 0.7;
/// Likeness that needs no second look.
const GOOD: f64 = 0.85;
/// Likeness of a frame, of its shot's, under which it is left out.
const LEFT_OUT: f64 = 0.75;
/// Likeness of a frame, of its neighbour's, under which it is looked for anew; how often that is done in any film, and
/// for how many of its frames.
const LOST: f64 = 0.8;
const SEARCHES: usize = 4;
const SEARCHED: usize = 16;
/// How often a shot of which nothing is known is looked for in a frame before it is given up; in another each time, if
/// there are as many.
const TRIES: usize = 6;

/// Where the frames of a film were taken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// Of each frame, where it is known.
    pub frames: Vec<Option<Fit>>,
    /// The shots that they are of.
    pub shots: Vec<Range<usize>>,
    /// Whether the film shows the asset mirrored: poses are those of its frames mirrored back.
    pub is_mirrored: bool,
    /// The likeliest that was seen before anything was followed.
    pub guess: Option<Fit>,
    /// How the film was made, as its last shot told.
    pub making: Making,
}

impl Track {
    /// Whether anything was found.
    #[must_use]
    pub fn is_found(&self) -> bool {
        self.frames.iter().any(Option::is_some)
    }
}

/// The asset, and small pictures of it to look for.
#[derive(Debug)]
pub struct Locator {
    pub(super) stage: Stage,
    bank: Bank,
    sought: Digest,
}

impl Locator {
    /// Of an unmarked asset.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn new(device: &Device, model: &Model, vantage: Vantage<'_>) -> Result<Self, EngineError> {
        let mut stage = Stage::new(device, model, vantage.about())?;
        let bank = Bank::new(&mut stage, vantage)?;
        Ok(Self { stage, bank, sought: vantage.digest_of(model) })
    }

    /// Hash of what is looked for.
    #[must_use]
    pub fn sought(&self) -> Digest {
        self.sought
    }

    /// The asset.
    #[must_use]
    pub fn stage(&self) -> &Stage {
        &self.stage
    }

    /// Finds where frames in sequence were taken; `model` is the same asset.
    ///
    /// # Errors
    /// When memory runs out, the device fails, or the observer stops the work.
    pub fn locate(
        &mut self,
        model: &Model,
        frames: &[Picture],
        observer: &mut dyn Observer,
    ) -> Result<Track, EngineError> {
        self.locate_from(SoFar::default(), model, frames, observer, &mut |_| Ok(()))
    }

    /// The same, from where another search for the same frames was broken off. `keep` is told what there is of it after
    /// each shot.
    ///
    /// # Errors
    /// As [`locate`](Self::locate), and those of `keep`.
    pub fn locate_from(
        &mut self,
        mut so_far: SoFar,
        model: &Model,
        frames: &[Picture],
        observer: &mut dyn Observer,
        keep: &mut dyn FnMut(&SoFar) -> Result<(), EngineError>,
    ) -> Result<Track, EngineError> {
        let shots = shots(frames.iter().map(|frame| &frame.gray));
        let mut work = Work { done: 0, total: 2 * frames.len() as u64, observer };
        let Some(longest) = (0..shots.len()).max_by_key(|shot| shots[*shot].len()) else { return Ok(Track::default()) };
        let First { begun: first, is_mirrored } = match so_far.first {
            Some(first) => first,
            None => {
                // Nothing of a film that was looked at before.
                self.stage.draw_as(model, Making::default())?;
                let first = self.either_way(&frames[shots[longest].clone()], &mut work)?;
                let searches = SEARCHES + frames.len() / SEARCHED;
                so_far = SoFar { first: Some(first), searches, ..SoFar::default() };
                keep(&so_far)?;
                first
            }
        };
        let mirrored: Vec<Picture>;
        let frames = if is_mirrored {
            mirrored = frames.iter().map(Picture::mirrored).collect();
            &mirrored
        } else {
            frames
        };
        work.done = 2 * so_far.shots.iter().map(|shot| shot.len() as u64).sum::<u64>();
        for (number, shot) in shots.iter().enumerate().skip(so_far.shots.len()) {
            self.stage.draw_as(model, so_far.making)?;
            let done = work.done + 2 * shot.len() as u64;
            let begun = if number == longest { first } else { self.first(&frames[shot.clone()], &mut work)? };
            let fits = match begun.filter(|begun| begun.likeness >= FOUND) {
                Some(begun) => {
                    let shot = Shot { model, frames: &frames[shot.clone()], begun };
                    self.shot(shot, &mut so_far.searches, &mut work)?
                }
                None => vec![None; shot.len()],
            };
            so_far.shots.push(fits.into_iter().map(|fit| fit.map(Exactly)).collect());
            so_far.making = self.stage.making();
            keep(&so_far)?;
            work.done = done;
        }
        let guess = first.map(|begun| Fit { correlation: begun.likeness, ..begun.fit.0 });
        let frames = so_far.shots.concat().into_iter().map(|fit| fit.map(|Exactly(fit)| fit)).collect();
        Ok(Track { frames, shots, is_mirrored, guess, making: so_far.making })
    }

    /// Looks for the asset in a shot, and for its mirror image if that is not plainly found.
    fn either_way(&mut self, frames: &[Picture], work: &mut Work<'_>) -> Result<First, EngineError> {
        let begun = self.first(frames, work)?;
        let likeness = |begun: Option<Begun>| begun.map_or(f64::NEG_INFINITY, |begun| begun.likeness);
        if likeness(begun) >= GOOD {
            return Ok(First { begun, is_mirrored: false });
        }
        // An asset that is much like its mirror image may be found in either.
        let mirrored: Vec<Picture> = frames.iter().map(Picture::mirrored).collect();
        let other = self.first(&mirrored, work)?;
        let is_mirrored = likeness(other) > likeness(begun);
        Ok(First { begun: if is_mirrored { other } else { begun }, is_mirrored })
    }

    fn shot(
        &mut self,
        Shot { model, frames, begun }: Shot<'_>,
        searches: &mut usize,
        work: &mut Work<'_>,
    ) -> Result<Vec<Option<Fit>>, EngineError> {
        let mut fits: Vec<Option<Fit>> = vec![None; frames.len()];
        fits[begun.frame] = Some(begun.fit.0);
        for way in both_ways(begun.frame, frames.len()) {
            let (mut last, mut earlier, mut before) = (begun.fit.0, None, begun.frame);
            for at in way {
                work.one("frames found")?;
                let fit = match is_same(&frames[at].gray, &frames[before].gray) {
                    true => last,
                    false => self.next(&frames[at], last, earlier, searches)?,
                };
                fits[at] = Some(fit);
                (earlier, last, before) = (Some(last), fit, at);
            }
        }
        let mut fits: Vec<Fit> = fits.into_iter().flatten().collect();
        draw_as(&mut self.stage, model, frames, &fits)?;
        settle(&mut self.stage, frames, &mut fits, begun.frame, work)?;
        let usual = median(fits.iter().map(|fit| fit.correlation));
        let is_sure = |fit: &Fit| usual >= KNOWN && fit.correlation >= LEFT_OUT * usual;
        Ok(fits.into_iter().map(|fit| is_sure(&fit).then_some(fit)).collect())
    }

    /// Looks for the asset in a few frames until it is found in one; where it is most like it.
    fn first(&mut self, frames: &[Picture], work: &mut Work<'_>) -> Result<Option<Begun>, EngineError> {
        let mut best: Option<Begun> = None;
        // Twice in the same frame where there are few: by edges of either kind.
        let tries = TRIES.min(2 * frames.len());
        for (number, place) in spread(2 * frames.len(), tries).enumerate() {
            work.look("looking for the asset")?;
            let frame = place / 2;
            if frames[frame].gray.is_plain() {
                continue;
            }
            // What hides it in one way may not in the other.
            let edges = if number % 2 == 0 { Edges::AsTheyAre } else { Edges::HeldDown };
            let Some(fit) = anywhere(&mut self.stage, &self.bank, &frames[frame], edges)? else { continue };
            let likeness = self.closely(&frames[frame], fit)?;
            if best.is_none_or(|best| likeness > best.likeness) {
                best = Some(Begun { frame, fit: Exactly(fit), likeness });
            }
            if likeness >= GOOD {
                break;
            }
        }
        Ok(best)
    }

    /// How like the original a frame is that may be found: small pictures alone leave that open, and of a close-up they
    /// have so few pixels that another asset may be alike in them.
    fn closely(&mut self, frame: &Picture, fit: Fit) -> Result<f64, EngineError> {
        if fit.correlation < FOUND {
            return Ok(fit.correlation);
        }
        let closer = align(&mut self.stage, &frame.gray, &fit.pose, TELL)?.correlation;
        Ok(if closer < FOUND { closer } else { closer.max(fit.correlation) })
    }

    /// A frame beside one that is known: from there, from where the last step leads, or from anywhere if it is not
    /// there.
    fn next(
        &mut self,
        frame: &Picture,
        last: Fit,
        earlier: Option<Fit>,
        searches: &mut usize,
    ) -> Result<Fit, EngineError> {
        let reach = NEAR + earlier.map_or(0.0, |earlier| (last.pose.time - earlier.pose.time).abs());
        let stage = &mut self.stage;
        let mut follow = |begun: Pose| -> Result<Fit, EngineError> {
            let pose = moments(stage, &frame.gray, &begun, SCANNED, reach)?.first().copied().unwrap_or(begun);
            align(stage, &frame.gray, &pose, NEXT)
        };
        let ahead = earlier.map_or(last.pose, |earlier| last.pose.moved(&last.pose.since(&earlier.pose)));
        let mut best = follow(ahead)?;
        if best.correlation < 0.9 * last.correlation && earlier.is_some() {
            let beside = follow(last.pose)?;
            best = if beside.correlation > best.correlation { beside } else { best };
        }
        if best.correlation >= FOUND.max(LOST * last.correlation) || *searches == 0 {
            return Ok(best);
        }
        *searches -= 1;
        let anew = anywhere(stage, &self.bank, frame, Edges::AsTheyAre)?;
        Ok(anew.filter(|fit| fit.correlation > best.correlation).unwrap_or(best))
    }
}

/// Frames without a cut, and where they begin to be found.
struct Shot<'a> {
    model: &'a Model,
    frames: &'a [Picture],
    begun: Begun,
}
