//! Poses brought nearer to a picture: Gauss–Newton steps on what differs (Lucas and Kanade 1981), damped (Levenberg
//! 1944, Marquardt 1963), with weights that forgive what does not fit (Huber 1964).

use nalgebra::{SMatrix, SVector};

use super::gray::{Gray, correlation};
use super::pose::{LENS, PARAMETERS, Pose, TIME};
use super::stage::{MOMENTS, Stage, Survey};
use crate::error::EngineError;
use crate::scene::FrameSize;

/// How far time is moved to see what it does.
const TIME_PROBE: f64 = 1.0 / 64.0;
/// Deviations beyond which a difference counts less (Huber): 95 % as good as least squares where errors are normal.
const HUBER: f64 = 1.345;
/// Least deviation of what differs, of 1: that of rounding and coding.
const LEAST_DEVIATION: f64 = 0.004;
/// Damping at first, and by what it changes.
const DAMPING: f64 = 1e-3;
const HARDER: f64 = 8.0;
/// Steps that were refused in a row, after which nothing better is near.
const REFUSED: usize = 3;
/// A step that moves nothing by so much is none, px.
const STILL_PX: f64 = 0.01;
/// Contrast that a film of the asset may have: less is not of it, or fitted to nothing.
const LEAST_GAIN: f64 = 0.3;
const MOST_GAIN: f64 = 3.0;
/// How far lenses stray from what was begun with, as a logarithm: pictures say little of them.
const LENS_SPREAD: f64 = 0.35;
/// How much that counts, in pixels that differ by a deviation.
const LENS_WEIGHT: f64 = 4.0;

/// Which parameters are free, and how long they may move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// Pixels across.
    pub width_px: u32,
    /// Steps at most.
    pub steps: usize,
    /// Whether the lens is free.
    pub lens: bool,
}

/// A pose and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: Pose,
    /// Robust mean square of what differs, over its variance where nothing is alike.
    pub cost: f64,
    /// How alike the gradients are, −1 to 1.
    pub correlation: f64,
}

/// What differs between a film's picture and the asset's.
struct Compared {
    seen: Survey,
    /// Film minus asset after the best exposure.
    residual: Vec<f64>,
    /// How bright the asset is in the film.
    gain: f64,
}

impl Compared {
    /// Beyond which differences count less: where the asset is seen, as most else may be background.
    fn bound(&self) -> f64 {
        let seen = self.residual.iter().zip(&self.seen.points).filter(|(_, point)| point.is_some());
        let mut sizes: Vec<f64> = seen.map(|(r, _)| r.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let middle = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
        HUBER * (1.4826 * middle).max(LEAST_DEVIATION)
    }

    fn cost(&self, bound: f64) -> f64 {
        cost(&self.residual, bound)
    }

    fn weights(&self, bound: f64) -> Vec<f64> {
        weights(&self.residual, bound)
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
    let target = level(film, plan.width_px);
    let width = target.width as f64;
    let mut pose = *begun;
    let mut at = compare(stage, &target, &pose, None)?;
    let mut bound = at.bound();
    let mut slope = Slope::at(stage, &target, &at, &pose, plan)?;
    let (mut damping, mut refused) = (DAMPING, 0);
    for _ in 0..plan.steps {
        let Some(step) = slope.step(&at, bound, pose.lens - begun.lens, damping) else { break };
        let moves = step.iter().zip(pose.reach()).map(|(step, reach)| (step * reach * width).powi(2)).sum::<f64>();
        if !moves.is_finite() || moves.sqrt() < STILL_PX {
            break;
        }
        let next = pose.moved(&step);
        let there = compare(stage, &target, &next, Some(bound))?;
        if there.cost(bound) < at.cost(bound) {
            (pose, at, damping, refused) = (next, there, damping / HARDER, 0);
            bound = at.bound();
            slope = Slope::at(stage, &target, &at, &pose, plan)?;
        } else {
            damping *= HARDER * HARDER;
            refused += 1;
            if refused == REFUSED {
                break;
            }
        }
    }
    Ok(Fit { pose, cost: at.cost(bound), correlation: correlation(&target, &at.seen.picture) })
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
    width_px: u32,
    reach: f64,
) -> Result<Vec<Pose>, EngineError> {
    if !stage.moves() {
        return Ok(vec![*pose]);
    }
    let target = level(film, width_px);
    let size = size_of(&target)?;
    let bound = compare(stage, &target, pose, None)?.bound();
    let mut tried = Vec::new();
    for moment in 0..=MOMENTS {
        let time = f64::from(moment) / f64::from(MOMENTS);
        if (time - pose.time).abs() <= reach {
            let there = Pose { time, ..*pose };
            tried.push(Tried {
                cost: cost(&difference(&stage.draw(&there, size)?, &target, Some(bound)).residual, bound),
                pose: there,
            });
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
}

impl Slope {
    /// By where each pixel's point moves to, and the gradient there; of time, by the difference of two pictures.
    fn at(stage: &mut Stage, film: &Gray, at: &Compared, pose: &Pose, plan: Plan) -> Result<Self, EngineError> {
        let Compared { seen, gain, .. } = at;
        let width = film.width as f64;
        let mut of = [const { None }; PARAMETERS];
        let known = if plan.lens { TIME } else { LENS };
        of[..known].fill_with(|| Some(vec![0.0; film.values.len()]));
        // The mean of both gradients: steps are of second order then (Malis 2004).
        let [own, there] = [&seen.picture, film].map(Gray::slope);
        for (pixel, point) in seen.points.iter().enumerate() {
            let Some(flow) = point.and_then(|point| pose.flow(stage.middle(), point)) else { continue };
            let [right, down] =
                [0, 1].map(|i| 0.5 * (gain * f64::from(own[i][pixel]) + f64::from(there[i][pixel])) * width);
            for (slope, [u, v]) in of.iter_mut().flatten().zip(flow) {
                slope[pixel] = -(right * u + down * v);
            }
        }
        if stage.moves() {
            let probe = if pose.time + TIME_PROBE > 1.0 { -TIME_PROBE } else { TIME_PROBE };
            let mut step = [0.0; PARAMETERS];
            step[TIME] = probe;
            let moved = stage.draw(&pose.moved(&step), size_of(film)?)?;
            let change = moved.values.iter().zip(&seen.picture.values);
            of[TIME] = Some(change.map(|(moved, drawn)| gain * f64::from(moved - drawn) / probe).collect());
        }
        Ok(Self { of })
    }

    /// The damped step; none where nothing moves the picture. `strayed` is how far the lens is from where it began.
    fn step(&self, at: &Compared, bound: f64, strayed: f64, damping: f64) -> Option<[f64; PARAMETERS]> {
        let weights = at.weights(bound);
        let (mut normal, mut right) = (SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros(), SVector::zeros());
        for (i, a) in self.of.iter().enumerate() {
            let Some(a) = a else {
                normal[(i, i)] = 1.0;
                continue;
            };
            right[i] = a.iter().zip(&at.residual).zip(&weights).map(|((a, r), w)| w * a * r).sum();
            for (j, b) in self.of.iter().enumerate().take(i + 1) {
                let Some(b) = b else { continue };
                let sum: f64 = a.iter().zip(b).zip(&weights).map(|((a, b), w)| w * a * b).sum();
                (normal[(i, j)], normal[(j, i)]) = (sum, sum);
            }
        }
        if self.of[LENS].is_some() {
            let pull = LENS_WEIGHT * at.cost(bound).max(LEAST_DEVIATION.powi(2)) / LENS_SPREAD.powi(2);
            normal[(LENS, LENS)] += pull;
            right[LENS] -= pull * strayed;
        }
        for i in 0..PARAMETERS {
            normal[(i, i)] += damping * normal[(i, i)] + f64::MIN_POSITIVE;
        }
        Some(normal.cholesky()?.solve(&right).into())
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

/// Draws the asset and takes it from the film, by the exposure and contrast that fit best.
fn compare(stage: &mut Stage, film: &Gray, pose: &Pose, bound: Option<f64>) -> Result<Compared, EngineError> {
    let seen = stage.survey(pose, size_of(film)?)?;
    let Difference { residual, gain } = difference(&seen.picture, film, bound);
    Ok(Compared { seen, residual, gain })
}

/// What is left of a film's picture after the asset's, and how bright that is in it.
struct Difference {
    residual: Vec<f64>,
    gain: f64,
}

/// Takes the asset's picture from a film's, once with all pixels alike and, with a bound, once with less of those that
/// fit worst.
fn difference(picture: &Gray, film: &Gray, bound: Option<f64>) -> Difference {
    let pairs: Vec<[f64; 2]> =
        picture.values.iter().zip(&film.values).map(|(x, y)| [f64::from(*x), f64::from(*y)]).collect();
    let (mut residual, mut gain) = through(&pairs, &vec![1.0; pairs.len()]);
    if let Some(bound) = bound {
        (residual, gain) = through(&pairs, &weights(&residual, bound));
    }
    Difference { residual, gain }
}

/// What is left of the second numbers after the best line through the first, and its slope.
fn through(pairs: &[[f64; 2]], weights: &[f64]) -> (Vec<f64>, f64) {
    let [mut n, mut sx, mut sy, mut sxx, mut sxy] = [0.0; 5];
    for ([x, y], w) in pairs.iter().zip(weights) {
        n += w;
        sx += w * x;
        sy += w * y;
        sxx += w * x * x;
        sxy += w * x * y;
    }
    let (x, y) = (sx / n, sy / n);
    let variance = sxx / n - x * x;
    let slope = if variance > f64::EPSILON { ((sxy / n - x * y) / variance).clamp(LEAST_GAIN, MOST_GAIN) } else { 1.0 };
    (pairs.iter().map(|[a, b]| b - y - slope * (a - x)).collect(), slope)
}
