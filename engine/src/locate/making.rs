//! How a film was made: by whose renderer, at which settings, and whether it was made smaller since.

use super::align::{Fit, Plan, align, costs_of};
use super::gray::Gray;
use super::picture::Picture;
use super::pose::Pose;
use super::search::LAST;
use super::stage::Stage;
use crate::base::spread::spread;
use crate::error::EngineError;
use crate::render::making::Making;
use crate::render::profile::Viewer;
use crate::scene::Model;

/// What pictures cost, of those that are made in a likelier way, to be taken for the film's.
const CLEARLY: f64 = 0.9;
/// Frames of a shot that tell: of so many spread over it those that fit best, as in one that is out of place more
/// differs by that than by any renderer.
const TELLING: usize = 2;
const TELLING_OF: usize = 9;
/// What a picture of the first of them costs, of the best yet, beyond which the others are not asked.
const HOPELESS: f64 = 1.5;
/// Steps to where frames fit the reference, and from there to where they fit another one: through any lens, as that of
/// the first guess is off and another renderer's splats may make up for it; at the same moment, as these take no part
/// in that. The reference goes on from there like any other, as none may have had fewer.
const BEGUN: Plan = Plan { lens: true, steps: 10, ..LAST };
const JUDGED: Plan = Plan { time: false, ..BEGUN };

/// Has the asset drawn as a film was whose frames these are: by its renderer, and at its size or at twice that and then
/// made smaller, whichever fits clearly better than those before, and in the end at settings that may not be the
/// renderer's own. Each is judged from where frames fit it: a camera makes up for some of another renderer's ways.
///
/// # Errors
/// When memory runs out or the device fails.
pub(super) fn draw_as(stage: &mut Stage, model: &Model, frames: &[Picture], fits: &[Fit]) -> Result<(), EngineError> {
    let mut telling: Vec<usize> = spread(frames.len(), TELLING_OF).collect();
    telling.sort_by(|a, b| fits[*a].cost.total_cmp(&fits[*b].cost));
    telling.truncate(TELLING);
    let frames: Vec<&Gray> = telling.iter().map(|at| &frames[*at].gray).collect();
    stage.draw_as(model, Making::default())?;
    let mut begun = Vec::new();
    for (frame, at) in frames.iter().zip(telling) {
        begun.push(align(stage, frame, &fits[at].pose, BEGUN)?.pose);
    }
    let mut judge = Judge { stage, model, frames, best: Making::default(), poses: begun.clone(), least: Vec::new() };
    for viewer in Viewer::ALL {
        judge.hear(Making { settings: viewer.into(), times: 1 }, &begun)?;
    }
    // Twice as large is four times the pixels: only by whom it may be, and from where it fits at its size.
    let (likeliest, poses) = (judge.best.settings, judge.poses.clone());
    judge.hear(Making { settings: Viewer::Reference.into(), times: 2 }, &begun)?;
    if likeliest.viewer != Viewer::Reference {
        judge.hear(Making { settings: likeliest, times: 2 }, &poses)?;
    }
    let (best, least) = (judge.best, judge.least.iter().sum());
    let mut cost = |settings| judge.cost(Making { settings, ..best });
    let settings = best.settings.fitted(model.gaussians.sh_degree, CLEARLY, least, &mut cost)?;
    judge.stage.draw_as(model, Making { settings, ..best })
}

/// The best so far.
struct Judge<'a> {
    stage: &'a mut Stage,
    model: &'a Model,
    frames: Vec<&'a Gray>,
    best: Making,
    /// From where the frames fit it.
    poses: Vec<Pose>,
    /// What each frame costs so.
    least: Vec<f64>,
}

impl Judge<'_> {
    /// What frames cost that were made like that, from where they fit the best.
    fn cost(&mut self, making: Making) -> Result<f64, EngineError> {
        self.stage.draw_as(self.model, making)?;
        let mut sum = 0.0;
        for (frame, pose) in self.frames.iter().zip(&self.poses) {
            sum += costs_of(self.stage, frame, &[*pose], LAST)?.iter().sum::<f64>();
        }
        Ok(sum)
    }

    /// Takes another way if frames fit it clearly better from where these poses lead, or, for larger ones, from there.
    fn hear(&mut self, making: Making, begun: &[Pose]) -> Result<(), EngineError> {
        self.stage.draw_as(self.model, making)?;
        let (mut costs, mut poses) = (Vec::new(), Vec::new());
        for (frame, pose) in self.frames.iter().zip(begun) {
            let pose = if making.times == 1 { align(self.stage, frame, pose, JUDGED)?.pose } else { *pose };
            costs.extend(costs_of(self.stage, frame, &[pose], LAST)?);
            poses.push(pose);
            if self.least.first().is_some_and(|least| costs[0] > HOPELESS * least) {
                return Ok(());
            }
        }
        let all = |costs: &[f64]| costs.iter().sum::<f64>();
        if self.least.is_empty() || all(&costs) < CLEARLY * all(&self.least) {
            (self.best, self.poses, self.least) = (making, poses, costs);
        }
        Ok(())
    }
}
