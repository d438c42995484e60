//! Poses brought nearer to a picture: Gauss–Newton steps on what differs (Lucas and Kanade 1981), damped (Levenberg
//! 1944, Marquardt 1963), with weights that forgive what does not fit (Huber 1964).

use nalgebra::{SMatrix, SVector};

use super::exposure::{Exposure, LEAST_DEVIATION, Levels};
use super::gray::{Gray, correlation_where};
use super::pose::{LENS, PARAMETERS, Pose, TIME};
use super::stage::{Canvas, Drawn, MERGED_PX, Shows, Stage, is_seen};
use crate::error::EngineError;
use crate::scene::FrameSize;

/// Deviations beyond which a difference counts less (Huber): 95 % as good as least squares where errors are normal.
const HUBER: f64 = 1.345;
/// Damping at first, and by what it changes.
const DAMPING: f64 = 1e-3;
const HARDER: f64 = 8.0;
/// Steps that were refused in a row, after which nothing better is near.
const REFUSED: usize = 3;
/// A step that moves nothing by so much is none, px.
const STILL_PX: f64 = 0.01;
/// The same of steps that cost many pictures: a fifth of what is asked of cameras by the best of them.
const STILL_EXACT_PX: f64 = 0.03;
/// How many bounds a difference is beyond which something is before the asset: four deviations.
const BEFORE_IT: f64 = 3.0;
/// Pixels of the asset and its outline under which what is alike may be by chance.
const LEAST_SEEN: f64 = 150.0;
/// How far parameters are moved to see what they do, px.
const PROBE_PX: f64 = 0.1;
/// How far a picture may move, px, before what was drawn to see what time does, or all of it for exact steps, is drawn
/// anew: a moment that was never drawn takes a network several times as long as its picture.
const KEPT_PX: f64 = 0.5;
/// Contrast beyond which, and beyond one over which, what is alike counts less: another asset is alike where it is made
/// faint, and no edit that leaves a film worth watching makes it so.
const PLAUSIBLE: f64 = 0.5;
/// Width of pictures whose size follows from the scene's, px.
const LEAST_PX: f64 = 12.0;
const MOST_PX: f64 = 256.0;
/// How far lenses stray from what was begun with, as a logarithm: pictures say little of them.
const LENS_SPREAD: f64 = 0.35;
/// How much that counts, in pixels that differ by a deviation.
const LENS_WEIGHT: f64 = 4.0;

/// Which parameters are free, and how long they may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// How large the pictures are.
    pub detail: Detail,
    /// Steps at most.
    pub steps: usize,
    /// Whether the lens is free.
    pub lens: bool,
    /// Whether the moment is free.
    pub time: bool,
    /// How the asset is drawn, and what steps follow from.
    pub way: Way,
}

/// How steps are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// From where points move to, in pictures that are drawn at twice their size.
    Small,
    /// The same, in pictures that are drawn at the film's size, as the film was.
    AsFilm,
    /// From pictures alone, one on each side for each parameter: many more are drawn. Where a turn hides what moves the
    /// difference of two slopes has to lead, and both have to be exact for that.
    Exact,
}

/// How large pictures are, at most as large as the film's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Detail {
    /// So many pixels across.
    Width(u32),
    /// So large that the scene's radius is so many pixels: what a turn moves is a share of it, and no step finds its
    /// way home over more than some pixels.
    Radius(f64),
}

impl Detail {
    /// Pixels across for a pose.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some dozens of pixels")]
    fn width_px(self, pose: &Pose) -> u32 {
        match self {
            Self::Width(width_px) => width_px,
            Self::Radius(px) => (px / pose.size.exp()).round().clamp(LEAST_PX, MOST_PX) as u32,
        }
    }
}

/// A pose and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: Pose,
    /// Robust mean square of what differs. It is less in pictures of fewer pixels: only poses at one size compare.
    pub cost: f64,
    /// How alike the gradients are where the asset is drawn, −1 to 1.
    pub correlation: f64,
    /// How much the picture says of the lens, all else being free: one over its variance; 0 where that was not asked.
    pub lens_weight: f64,
    /// How many times less is known of the moment because the rest is free; 1 where it is not asked.
    pub tied: f64,
}

/// What differs between a film's picture and the asset's from a pose.
struct Compared {
    pose: Pose,
    drawn: Drawn,
    left: Difference,
}

impl Compared {
    /// Beyond which differences count less: where the asset is seen, as most else may be background.
    fn bound(&self) -> f64 {
        let seen = self.left.residual.iter().zip(&self.drawn.clear.values).filter(|(_, clear)| is_seen(**clear));
        let mut sizes: Vec<f64> = seen.map(|(r, _)| r.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let middle = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
        HUBER * (1.4826 * middle).max(LEAST_DEVIATION)
    }

    fn cost(&self, bound: f64) -> f64 {
        cost(&self.left.residual, bound)
    }

    fn weights(&self, bound: f64) -> Vec<f64> {
        weights(&self.left.residual, bound)
    }

    /// How alike the gradients are where the asset is drawn and nothing before it: what else a film shows, a logo or
    /// what is behind, says nothing of where it was taken. The fewer pixels that are, or the fainter, the less.
    fn likeness(&self, film: &Gray, bound: f64) -> f64 {
        let fits = |r: &f64| f32::from(u8::from(r.abs() <= BEFORE_IT * bound));
        let fits = Gray { values: self.left.residual.iter().map(fits).collect(), ..*film };
        // A gradient is of a pixel and those beside it.
        let fits = fits.least_within(1).values;
        let counts: Vec<bool> =
            self.drawn.outlined().iter().zip(fits).map(|(near, fits)| *near && fits > 0.0).collect();
        let counted = counts.iter().filter(|counts| **counts).count() as f64;
        let gain = self.left.exposure.gain;
        let counts_for = (counted / LEAST_SEEN).min(1.0) * (gain.min(1.0 / gain) / PLAUSIBLE).min(1.0);
        counts_for * correlation_where(film, &self.left.shown, |at| counts[at])
    }
}

/// Mean of Huber's measure.
fn cost(residual: &[f64], bound: f64) -> f64 {
    let huber = |r: &f64| if r.abs() <= bound { r * r } else { bound * (2.0 * r.abs() - bound) };
    residual.iter().map(huber).sum::<f64>() / residual.len() as f64
}

fn weights(residual: &[f64], bound: f64) -> Vec<f64> {
    residual.iter().map(|r| if r.abs() <= bound { 1.0 } else { bound / r.abs() }).collect()
}

/// Moves a pose until it fits a picture of a film best.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn align(stage: &mut Stage, film: &Gray, begun: &Pose, plan: Plan) -> Result<Fit, EngineError> {
    let begun = &stage.about_what_is_seen(begun)?;
    let target = Target::new(film, begun, plan.detail, plan.way)?;
    let width = target.picture.width as f64;
    let mut at = target.compare(stage, begun, None)?;
    let mut bound = at.bound();
    let mut slope = Slope::at(stage, &target, &at, plan, None)?;
    let (mut damping, mut refused) = (DAMPING, 0);
    for _ in 0..plan.steps {
        let Some(step) = slope.normal(&at, bound, at.pose.lens - begun.lens).step(damping) else { break };
        let moves = step.iter().zip(at.pose.reach()).map(|(step, reach)| (step * reach * width).powi(2)).sum::<f64>();
        let still = if plan.way == Way::Exact { STILL_EXACT_PX } else { STILL_PX };
        if !moves.is_finite() || moves.sqrt() < still {
            break;
        }
        let there = target.compare(stage, &at.pose.moved(&step), Some(bound))?;
        if there.cost(bound) < at.cost(bound) {
            (at, damping, refused) = (there, damping / HARDER, 0);
            bound = at.bound();
            slope = Slope::at(stage, &target, &at, plan, Some(slope))?;
        } else if slope.drawn_at != at.pose {
            slope = Slope::at(stage, &target, &at, plan, None)?;
        } else {
            damping *= HARDER * HARDER;
            refused += 1;
            if refused == REFUSED {
                break;
            }
        }
    }
    let normal = slope.normal(&at, bound, 0.0);
    let lens_weight = if plan.lens { normal.known(LENS) / at.cost(bound) } else { 0.0 };
    let tied = if plan.time && stage.moves() { normal.matrix[(TIME, TIME)] / normal.known(TIME) } else { 1.0 };
    let correlation = at.likeness(&target.picture, bound);
    Ok(Fit { pose: at.pose, cost: at.cost(bound), correlation, lens_weight, tied })
}

/// What poses cost as they are, in what differs where the asset is drawn from any of them, by one measure for all.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn costs_of(stage: &mut Stage, film: &Gray, poses: &[Pose], plan: Plan) -> Result<Vec<f64>, EngineError> {
    let Some(first) = poses.first() else { return Ok(Vec::new()) };
    let target = Target::new(film, first, plan.detail, plan.way)?;
    let mut seen = vec![false; target.picture.values.len()];
    let (mut drawn, mut bound) = (Vec::new(), f64::INFINITY);
    for pose in poses {
        let there = target.compare(stage, pose, None)?;
        bound = bound.min(there.bound());
        seen.iter_mut().zip(there.drawn.outlined()).for_each(|(seen, here)| *seen |= here);
        drawn.push(there.drawn);
    }
    let cost = |drawn: &Drawn| {
        let left = difference(drawn, &target.picture, Some(bound), target.levels()).residual;
        let left: Vec<f64> = left.into_iter().zip(&seen).filter_map(|(r, seen)| seen.then_some(r)).collect();
        if left.is_empty() { f64::INFINITY } else { cost(&left, bound) }
    };
    Ok(drawn.iter().map(cost).collect())
}

/// Moments at which a film's picture is like the asset from a pose, the likeliest first: of those that are kept within
/// `reach` of the pose's, each that is likelier than both of its neighbours. Movement goes there and back, so that what
/// is near is not always downhill, and what is most alike in a small picture not always right.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn moments(
    stage: &mut Stage,
    film: &Gray,
    pose: &Pose,
    detail: Detail,
    reach: f64,
) -> Result<Vec<Pose>, EngineError> {
    if !stage.moves() {
        return Ok(vec![*pose]);
    }
    let target = Target::new(film, pose, detail, Way::Small)?;
    let bound = target.compare(stage, pose, None)?.bound();
    let mut tried = Vec::new();
    for step in 0..=stage.steps() {
        let time = f64::from(step) / f64::from(stage.steps());
        if (time - pose.time).abs() <= reach {
            let there = Pose { time, ..*pose };
            tried.push(Tried { cost: target.compare(stage, &there, Some(bound))?.cost(bound), pose: there });
        }
    }
    let beside = |at: Option<usize>| at.and_then(|at| tried.get(at)).map_or(f64::INFINITY, |tried| tried.cost);
    let is_least = |at: &usize| {
        let cost = tried[*at].cost;
        cost <= beside(at.checked_sub(1)) && cost <= beside(at.checked_add(1))
    };
    let mut least: Vec<&Tried> = (0..tried.len()).filter(is_least).map(|at| &tried[at]).collect();
    least.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    Ok(least.into_iter().map(|tried| tried.pose).collect())
}

/// A pose and what differs there.
struct Tried {
    pose: Pose,
    cost: f64,
}

/// What each free parameter does to the picture.
struct Slope {
    of: [Option<Vec<f64>>; PARAMETERS],
    /// From where pictures were drawn for it.
    drawn_at: Pose,
}

impl Slope {
    /// What is free in a plan. What was drawn for the last one stays, if that is from nearby.
    fn at(
        stage: &mut Stage,
        film: &Target,
        at: &Compared,
        plan: Plan,
        last: Option<Self>,
    ) -> Result<Self, EngineError> {
        let width = film.picture.width as f64;
        let (mut of, drawn_at) = match last.filter(|last| last.drawn_at.apart_px(&at.pose, width) < KEPT_PX) {
            Some(last) if plan.way == Way::Exact => return Ok(last),
            Some(Self { mut of, drawn_at }) if of[TIME].is_some() => {
                of[..TIME].fill(None);
                (of, drawn_at)
            }
            _ => ([const { None }; PARAMETERS], at.pose),
        };
        let moves = stage.moves();
        let is_free = |parameter: usize| match parameter {
            LENS => plan.lens,
            TIME => plan.time && moves,
            _ => true,
        };
        if plan.way != Way::Exact {
            let known = Self::by_flow(stage, film, at)?;
            known.into_iter().zip(&mut of).for_each(|(known, of)| *of = Some(known));
        }
        for (parameter, of) in of.iter_mut().enumerate() {
            if !is_free(parameter) {
                *of = None;
            } else if of.is_none() {
                let by = match (parameter, plan.way) {
                    (TIME, Way::Small) => 1.0 / f64::from(stage.steps()),
                    _ => PROBE_PX / film.picture.width as f64 / at.pose.reach()[parameter],
                };
                // Time ends.
                let by = if parameter == TIME && at.pose.time + by > 1.0 { -by } else { by };
                let probe = Probe { parameter, by, on_both_sides: plan.way == Way::Exact };
                *of = Some(Self::drawn(stage, film, at, probe)?);
            }
        }
        Ok(Self { of, drawn_at })
    }

    /// By where each pixel's point moves to, and the gradient there: fast, and near enough to lead on.
    fn by_flow(stage: &mut Stage, film: &Target, at: &Compared) -> Result<Vec<Vec<f64>>, EngineError> {
        let width = film.picture.width as f64;
        let mut of = vec![vec![0.0; film.picture.values.len()]; TIME];
        // The mean of both gradients: steps are of second order then (Malis 2004).
        let [own, there] = [&at.left.shown, &film.picture].map(Gray::slope);
        for (pixel, point) in stage.points(&at.pose, film.canvas)?.into_iter().enumerate() {
            let Some(flow) = point.and_then(|point| at.pose.flow(point)) else { continue };
            let [right, down] = [0, 1].map(|i| 0.5 * f64::from(own[i][pixel] + there[i][pixel]) * width);
            for (slope, [u, v]) in of.iter_mut().zip(flow) {
                slope[pixel] = -(right * u + down * v);
            }
        }
        Ok(of)
    }

    /// By the difference of two pictures: this one and one beside it, or, for exact steps, one on each side.
    fn drawn(stage: &mut Stage, film: &Target, at: &Compared, probe: Probe) -> Result<Vec<f64>, EngineError> {
        let Probe { parameter, by, on_both_sides } = probe;
        let [before, behind] = [if on_both_sides { -by } else { 0.0 }, by].map(|by| {
            let mut step = [0.0; PARAMETERS];
            step[parameter] = by;
            at.pose.moved(&step)
        });
        let apart = behind.since(&before)[parameter];
        let mut shown = |pose| Ok(at.left.exposure.of(&stage.draw(&pose, film.canvas)?).values);
        let behind: Vec<f32> = shown(behind)?;
        let before: Result<Vec<f32>, EngineError> =
            if on_both_sides { shown(before) } else { Ok(at.left.shown.values.clone()) };
        Ok(before?.iter().zip(behind).map(|(before, behind)| f64::from(behind - before) / apart).collect())
    }

    /// What a step solves. `strayed` is how far the lens is from where it began.
    fn normal(&self, at: &Compared, bound: f64, strayed: f64) -> Normal {
        let weights = at.weights(bound);
        let (mut matrix, mut right) = (SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros(), SVector::zeros());
        for (i, a) in self.of.iter().enumerate() {
            let Some(a) = a else {
                matrix[(i, i)] = 1.0;
                continue;
            };
            right[i] = a.iter().zip(&at.left.residual).zip(&weights).map(|((a, r), w)| w * a * r).sum();
            for (j, b) in self.of.iter().enumerate().take(i + 1) {
                let Some(b) = b else { continue };
                let sum: f64 = a.iter().zip(b).zip(&weights).map(|((a, b), w)| w * a * b).sum();
                (matrix[(i, j)], matrix[(j, i)]) = (sum, sum);
            }
        }
        if self.of[LENS].is_some() {
            let pull = LENS_WEIGHT * at.cost(bound).max(LEAST_DEVIATION.powi(2)) / LENS_SPREAD.powi(2);
            matrix[(LENS, LENS)] += pull;
            right[LENS] -= pull * strayed;
        }
        Normal { matrix, right }
    }
}

/// How far which parameter is moved to see what it does.
#[derive(Clone, Copy)]
struct Probe {
    parameter: usize,
    by: f64,
    on_both_sides: bool,
}

/// The normal equations of a step.
struct Normal {
    matrix: SMatrix<f64, PARAMETERS, PARAMETERS>,
    right: SVector<f64, PARAMETERS>,
}

impl Normal {
    /// The damped step; none where nothing moves the picture.
    fn step(&self, damping: f64) -> Option<[f64; PARAMETERS]> {
        let mut damped = self.matrix;
        for i in 0..PARAMETERS {
            damped[(i, i)] += damping * damped[(i, i)] + f64::MIN_POSITIVE;
        }
        Some(damped.cholesky()?.solve(&self.right).into())
    }

    /// What is said of a parameter when all others are free (the Schur complement).
    fn known(&self, parameter: usize) -> f64 {
        let inverse = self.matrix.cholesky().map(|factor| factor.inverse());
        inverse.map_or(0.0, |inverse| 1.0 / inverse[(parameter, parameter)])
    }
}

/// A film's picture as it is compared.
struct Target {
    picture: Gray,
    canvas: Canvas,
}

impl Target {
    /// As large as suits a pose, or as it is where that is less.
    fn new(film: &Gray, pose: &Pose, detail: Detail, way: Way) -> Result<Self, EngineError> {
        let picture = level(film, detail.width_px(pose));
        let size = size_of(&picture)?;
        let shows = match (way, detail) {
            (Way::AsFilm | Way::Exact, _) => Shows::AsFilm(size_of(film)?),
            (Way::Small, Detail::Radius(px)) if px <= MERGED_PX => Shows::Smallest,
            (Way::Small, _) => Shows::Small,
        };
        let canvas = Canvas { size, shows };
        Ok(Self { picture, canvas })
    }

    /// Draws the asset and takes it from the film.
    fn compare(&self, stage: &mut Stage, pose: &Pose, bound: Option<f64>) -> Result<Compared, EngineError> {
        let drawn = stage.draw(pose, self.canvas)?;
        let left = difference(&drawn, &self.picture, bound, self.levels());
        Ok(Compared { pose: *pose, drawn, left })
    }

    /// Only what is drawn as the film was tells more of its levels than contrast and brightness.
    fn levels(&self) -> Levels {
        match self.canvas.shows {
            Shows::AsFilm(_) => Levels::Bent,
            Shows::Small | Shows::Smallest => Levels::Straight,
        }
    }
}

/// A film's picture at so many pixels across, or as it is where that is less.
fn level(film: &Gray, width_px: u32) -> Gray {
    let width = usize::try_from(width_px).unwrap_or(usize::MAX).min(film.width);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a side of a frame")]
    let height = (width as f64 * film.height as f64 / film.width as f64).round().max(1.0) as usize;
    film.resized(width, height)
}

fn size_of(picture: &Gray) -> Result<FrameSize, EngineError> {
    let [width, height] = [picture.width, picture.height].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
    FrameSize::new(width, height)
}

/// What is left of a film's picture after the asset's as that film would show it.
struct Difference {
    residual: Vec<f64>,
    /// The asset with the film's contrast and brightness, over the film's background.
    shown: Gray,
    exposure: Exposure,
}

/// Takes the asset's picture from a film's, once with all pixels alike and, with a bound, once with less of those that
/// fit worst.
fn difference(drawn: &Drawn, film: &Gray, bound: Option<f64>, levels: Levels) -> Difference {
    let fitted = |weights: &[f64]| {
        let exposure = Exposure::fitted(drawn, film, weights, levels);
        let shown = exposure.of(drawn);
        let residual = film.values.iter().zip(&shown.values).map(|(film, shown)| f64::from(film - shown)).collect();
        Difference { residual, shown, exposure }
    };
    let first = fitted(&vec![1.0; film.values.len()]);
    match bound {
        Some(bound) => fitted(&weights(&first.residual, bound)),
        None => first,
    }
}
