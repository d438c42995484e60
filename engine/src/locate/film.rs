//! The frames of a film, shot by shot.

use std::ops::Range;

use guard4d_kernels::Device;

use super::align::{Detail, Fit, Plan, Way, align, costs_of, moments};
use super::bank::{Bank, Edges};
use super::making::draw_as;
use super::picture::Picture;
use super::pose::Pose;
use super::search::{LAST, SCANNED, TIED, anywhere, with_lens};
use super::shots::{is_same, shots};
use super::so_far::{Begun, Exactly, First, SoFar};
use super::stage::{Making, Stage};
use super::views::Vantage;
use crate::base::digest::Digest;
use crate::base::observer::{Observer, Progress};
use crate::base::spread::spread;
use crate::error::EngineError;
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
/// How far the next frame's moment may be from where it is looked for: so much, and as far as that is from the last.
const NEAR: f64 = 0.06;
/// Frames of a shot that tell its lens.
const TELLING: usize = 10;
/// How far a frame is from between its neighbours to be looked at again: in pixels, and of what is usual.
const APART_PX: f64 = 2.0;
const APART_OF_USUAL: f64 = 4.0;
/// What a place costs, of an earlier one, to be begun at instead: movement is even, and where a turn hides it pictures
/// say little of how far along it is.
const MUCH_BETTER: f64 = 0.6;
/// What a frame costs, of what is usual beside it, to be looked at again; moments that are tried then.
const DEAR: f64 = 1.4;
const BESIDE: usize = 4;
const ALIKE: usize = 3;

/// Steps for a frame whose neighbour is known.
const NEXT: Plan = Plan { detail: Detail::Radius(40.0), steps: 5, lens: false, time: true, way: Way::Small };
/// Steps at the end, for those that tell the lens.
const TELL: Plan = Plan { detail: Detail::Width(384), steps: 8, lens: true, time: true, way: Way::AsFilm };
const TELL_EXACTLY: Plan = Plan { way: Way::Exact, ..TELL };
const LAST_EXACTLY: Plan = Plan { steps: 6, way: Way::Exact, ..LAST };

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
            self.stage.set_rough(true);
            self.stage.draw_as(model, so_far.making)?;
            let done = work.done + 2 * shot.len() as u64;
            let begun = if number == longest { first } else { self.first(&frames[shot.clone()], &mut work)? };
            let fits = match begun.filter(|begun| begun.fit.0.correlation >= FOUND) {
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
        let frames = so_far.shots.concat().into_iter().map(|fit| fit.map(|Exactly(fit)| fit)).collect();
        Ok(Track { frames, shots, is_mirrored, guess: first.map(|begun| begun.fit.0), making: so_far.making })
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
        let forward: Vec<usize> = (begun.frame + 1..frames.len()).collect();
        let backward: Vec<usize> = (0..begun.frame).rev().collect();
        for way in [forward, backward] {
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
        self.stage.set_rough(false);
        draw_as(&mut self.stage, model, frames, &fits)?;
        self.settle(frames, &mut fits, begun.frame, work)?;
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

    /// How like the original a frame is that may be found: small pictures alone leave that open.
    fn closely(&mut self, frame: &Picture, fit: Fit) -> Result<f64, EngineError> {
        if !(FOUND..GOOD).contains(&fit.correlation) {
            return Ok(fit.correlation);
        }
        let was_rough = self.stage.is_rough();
        self.stage.set_rough(false);
        let closer = align(&mut self.stage, &frame.gray, &fit.pose, TELL)?;
        self.stage.set_rough(was_rough);
        Ok(fit.correlation.max(closer.correlation))
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

    /// Brings all frames of a shot to where they fit best with one lens, and beside each other.
    fn settle(
        &mut self,
        frames: &[Picture],
        fits: &mut [Fit],
        begun: usize,
        work: &mut Work<'_>,
    ) -> Result<(), EngineError> {
        let stage = &mut self.stage;
        let usual = median(fits.iter().map(|fit| fit.pose.lens));
        let mut lenses = Vec::new();
        for at in spread(frames.len(), TELLING) {
            work.look("the lens")?;
            let fit = align(stage, &frames[at].gray, &with_lens(fits[at].pose, usual), TELL)?;
            let fit = if fit.tied > TIED { align(stage, &frames[at].gray, &fit.pose, TELL_EXACTLY)? } else { fit };
            lenses.push(Weighed { value: fit.pose.lens, weight: fit.lens_weight });
        }
        let lens = weighted_median(lenses).unwrap_or(usual);
        // From the frame that was found first to both ends: what was mended there is mended in the next, too.
        let found = fits.to_vec();
        let forward: Vec<usize> = (begun..frames.len()).collect();
        let backward: Vec<usize> = (0..begun).rev().collect();
        for way in [forward, backward] {
            for at in way {
                work.one("cameras refined")?;
                let toward = |by: usize| if at > begun { at.checked_sub(by) } else { Some(at + by) };
                let between = begun.min(at)..=begun.max(at);
                let known = |by: usize| toward(by).filter(|other| at != begun && between.contains(other));
                if let Some(beside) = known(1).filter(|beside| is_same(&frames[at].gray, &frames[*beside].gray)) {
                    fits[at] = fits[beside];
                    continue;
                }
                let mut starts = Vec::new();
                if let Some(last) = known(1) {
                    let ahead = known(2).map(|earlier| fits[last].pose.since(&fits[earlier].pose));
                    starts.push(fits[last].pose.moved(&ahead.unwrap_or_default()));
                    starts.push(found[at].pose.moved(&fits[last].pose.since(&found[last].pose)));
                }
                starts.push(found[at].pose);
                fits[at] = last_steps(&mut self.stage, &frames[at], &starts, lens)?;
            }
        }
        self.look_again(frames, fits, work)
    }

    /// Looks again at frames that are beside the way, or much less like the original than the others: from where the
    /// way leads, and at every moment.
    fn look_again(&mut self, frames: &[Picture], fits: &mut [Fit], work: &mut Work<'_>) -> Result<(), EngineError> {
        let width = frames.first().map_or(0.0, |frame| frame.gray.width as f64);
        let apart: Vec<Option<f64>> =
            (0..fits.len()).map(|at| Some(apart_px(&fits[at].pose, &between(fits, at)?, width))).collect();
        let far = APART_PX.max(APART_OF_USUAL * median(apart.iter().flatten().copied()));
        for at in 0..fits.len() {
            let beside = &fits[at.saturating_sub(BESIDE)..(at + 1 + BESIDE).min(fits.len())];
            let dear = DEAR * median(beside.iter().map(|fit| fit.cost));
            if !(fits[at].cost > dear || apart[at].is_some_and(|apart| apart > far)) {
                continue;
            }
            work.look("frames beside the way")?;
            let mut begun: Vec<Pose> = between(fits, at).into_iter().collect();
            self.stage.set_rough(true);
            let from = begun.first().copied().unwrap_or(fits[at].pose);
            begun.extend(moments(&mut self.stage, &frames[at].gray, &from, SCANNED, 1.0)?.into_iter().take(ALIKE));
            self.stage.set_rough(false);
            let mut best: Option<Fit> = None;
            for pose in begun {
                let fit = align(&mut self.stage, &frames[at].gray, &pose, NEXT)?;
                best = best.filter(|best| best.cost <= fit.cost).or(Some(fit));
            }
            if let Some(best) = best {
                let fit = align(&mut self.stage, &frames[at].gray, &best.pose, LAST)?;
                fits[at] = if fit.cost < fits[at].cost { fit } else { fits[at] };
            }
        }
        Ok(())
    }
}

/// A frame's last steps, from the first of several places unless it fits much better in another.
fn last_steps(stage: &mut Stage, frame: &Picture, starts: &[Pose], lens: f64) -> Result<Fit, EngineError> {
    let starts: Vec<Pose> = starts.iter().map(|start| with_lens(*start, lens)).collect();
    let costs = costs_of(stage, &frame.gray, &starts, LAST)?;
    let mut best = 0;
    for at in 1..starts.len() {
        best = if costs[at] < MUCH_BETTER * costs[best] { at } else { best };
    }
    let fit = align(stage, &frame.gray, &starts[best], LAST)?;
    if fit.tied > TIED { align(stage, &frame.gray, &fit.pose, LAST_EXACTLY) } else { Ok(fit) }
}

/// Between the poses of a frame's neighbours, where it has two.
fn between(fits: &[Fit], at: usize) -> Option<Pose> {
    let (before, behind) = (fits.get(at.checked_sub(1)?)?.pose, fits.get(at + 1)?.pose);
    Some(before.toward(&behind, 0.5))
}

/// Roughly how far two poses' pictures are apart, px of a picture of this width.
#[must_use]
pub fn apart_px(a: &Pose, b: &Pose, width: f64) -> f64 {
    let steps = a.since(b).into_iter().zip(b.reach());
    width * steps.map(|(step, reach)| (step * reach).powi(2)).sum::<f64>().sqrt()
}

/// Frames without a cut, and where they begin to be found.
struct Shot<'a> {
    model: &'a Model,
    frames: &'a [Picture],
    begun: Begun,
}

/// How far the work is, and who is told.
struct Work<'a> {
    done: u64,
    total: u64,
    observer: &'a mut dyn Observer,
}

impl Work<'_> {
    /// Tells what is done next.
    fn look(&mut self, stage: &str) -> Result<(), EngineError> {
        self.observer.observe(Progress { stage, done: self.done, total: Some(self.total) })
    }

    /// Tells the same, of one of all frames' two rounds.
    fn one(&mut self, stage: &str) -> Result<(), EngineError> {
        self.done += 1;
        self.look(stage)
    }
}

/// A number and how much it counts.
#[derive(Clone, Copy)]
struct Weighed {
    value: f64,
    weight: f64,
}

/// The number on both sides of which there is as much weight; none where there is none.
fn weighted_median(mut numbers: Vec<Weighed>) -> Option<f64> {
    numbers.sort_by(|a, b| a.value.total_cmp(&b.value));
    let half = 0.5 * numbers.iter().map(|number| number.weight).sum::<f64>();
    let mut sum = 0.0;
    numbers.into_iter().find_map(|Weighed { value, weight }| {
        sum += weight;
        (weight > 0.0 && sum >= half).then_some(value)
    })
}

/// The middle one; 0 of none.
pub(super) fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.collect();
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(0.0)
}
