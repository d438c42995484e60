//! What an embedding will take, found by preparing a few of its clips and taking a few of its steps.

use std::collections::BTreeSet;
use std::time::Instant;

use serde::Serialize;

use super::config::EmbedConfig;
use super::draw::{draw, window};
use super::embedding::Embedding;
use super::fit::{CLIPS_PER_PROBE, ZERO_CLIPS};
use super::pool::{ClipPool, FITTED};
use super::subject::{Start, Subject};
use crate::error::EngineError;

/// Training clips that are made to learn what a clip takes; views differ by some percent.
const SAMPLED_CLIPS: usize = 8;
/// Steps that are timed, or as many more as controls and LPIPS take to come round, after those in which the driver
/// compiles.
const TIMED_STEPS: usize = 2;
/// Forward passes of the extractor by which the work of a fit is counted: for each clip, for each random field, and for
/// each of the clips that set the zero.
const PASSES_PER_CLIP: usize = 1;
const PASSES_PER_PROBE: usize = CLIPS_PER_PROBE;
const PASSES_PER_ZERO: usize = 2;

/// Memory and time of an embedding, before it is done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Splats.
    pub splats: usize,
    /// Clips, those that are only measured among them.
    pub clips: usize,
    /// Clips that were made to estimate the others from.
    pub sampled_clips: usize,
    /// Mean bytes of a clip: frame plans and unmarked frames.
    pub clip_bytes: u64,
    /// Bytes of everything else at its peak.
    pub resident_bytes: u64,
    /// Most bytes taken from the driver at one time, what LPIPS keeps of unmarked clips among them.
    pub peak_memory_bytes: u64,
    /// Bytes that may be taken from the driver, if there is a limit.
    pub budget_bytes: Option<u64>,
    /// Clips that are in memory at one time; the others are made again when their turn comes.
    pub clips_in_memory: usize,
    /// Seconds for planning, those for making clips again among them.
    pub plan_seconds: f64,
    /// Seconds for fitting the extractor, try-outs of rotations among them.
    pub fit_seconds: f64,
    /// Seconds for all steps, held-out measurements among them, as if LPIPS kept nothing of unmarked clips.
    pub train_seconds: f64,
}

impl Estimate {
    /// Prepares a sample and extrapolates: memory in proportion to the number of clips, time also to steps and random
    /// fields. Of a schedule it is the most: all clips, and all steps as in the first phase. Steps in which R is held
    /// count as if it were trained. The times suppose that nothing else keeps the device busy.
    ///
    /// # Errors
    /// As [`Embedding::prepare`], also when the sample does not fit into the memory budget.
    pub fn of(subject: Subject<'_>, config: &EmbedConfig) -> Result<Self, EngineError> {
        config.validate_for(subject.key.bits())?;
        let device = subject.device;
        let budget = device.memory_budget();
        let few = config.clone().with_rotations(1).with_probes(subject.key.bits());
        let few = few.with(|few| few.extractor.joint_mut().into_iter().for_each(|joint| joint.tmsd_held = 0.0));
        let mut pool = ClipPool::draw(device, subject.model, &subject.key.prf(), &few)?;
        let (clips, moments) = (pool.len(), pool.num_moments());
        pool.thin_out(SAMPLED_CLIPS);
        let (sampled, sampled_moments) = (pool.len(), pool.num_moments());
        let mut embedding = Embedding::prepare_on(subject, few.clone(), Start::Fit, pool)?;
        // Steps with a control or with LPIPS take longer than those without: a whole number of rounds is timed.
        let round = config.round();
        let timed_steps = TIMED_STEPS.next_multiple_of(round);
        let mut timed = 0.0;
        for step in 0..(round + timed_steps).min(config.optimiser.steps) {
            let started = Instant::now();
            embedding.step()?;
            timed += if step < round { 0.0 } else { started.elapsed().as_secs_f64() };
        }
        let started = Instant::now();
        embedding.held_out()?;
        let measuring = started.elapsed().as_secs_f64();

        let (used, kept) = (device.memory_use(), embedding.clips.bytes());
        let clip_bytes = kept / embedding.clips.in_memory().max(1) as u64;
        // Other buffers of this device, such as CLIP's weights, are part of it.
        let passing = kept + embedding.clips.features_bytes() + embedding.clips.moments_bytes();
        let resident_bytes = used.peak_reserved_bytes - passing + embedding.clips.bytes_of_moments(moments);
        let room = embedding.clips.most_bytes() / clip_bytes.max(1);
        let most_kept = clips.min(usize::try_from(room).unwrap_or(usize::MAX).max(1));
        let mut all = resident_bytes + clip_bytes * most_kept as u64;
        // Only what all clips have room for beside them.
        if most_kept == clips && budget.is_none_or(|bytes| all <= bytes) {
            all += embedding.kept_by_lpips(config);
        }
        let room = budget.map_or(u64::MAX, |bytes| bytes.saturating_sub(resident_bytes));
        let in_memory = usize::try_from(room / clip_bytes.max(1)).unwrap_or(usize::MAX).clamp(1, most_kept);
        let missed = 1.0 - in_memory as f64 / most_kept as f64;
        let plans = embedding.plan_times(sampled_moments, moments)?;
        let passes = |config: &EmbedConfig, clips: usize| {
            let zero = PASSES_PER_ZERO * clips.min(ZERO_CLIPS);
            (PASSES_PER_CLIP * clips + PASSES_PER_PROBE * config.extractor.probes() + zero) as f64
        };
        let fitted_clips = (config.in_phase(0).views.clips as usize).min(FITTED);
        let fitted = passes(config, fitted_clips);
        // Each of these asks for a clip, and so does each step.
        let asked = fitted + (config.try_out_steps() + config.optimiser.steps) as f64;
        let step_seconds = timed / timed_steps as f64;
        let measured = config.most_evaluations();
        // Clips that are fitted to and have no room are made for that alone: once, and for the random fields that fall
        // to them.
        let beyond = fitted_clips.saturating_sub(most_kept) as f64;
        let per_beyond = 1.0 + (PASSES_PER_PROBE * config.extractor.probes()) as f64 / fitted_clips as f64;
        Ok(Self {
            splats: subject.model.gaussians.len(),
            clips,
            sampled_clips: sampled,
            clip_bytes,
            resident_bytes,
            peak_memory_bytes: budget.map_or(all, |bytes| all.min(bytes)),
            budget_bytes: budget,
            clips_in_memory: in_memory,
            plan_seconds: plans.per_clip * (clips as f64 + beyond * per_beyond + missed * asked) + plans.for_moments,
            fit_seconds: embedding.seconds["fit"] * fitted / passes(&few, embedding.clips.fitted().len())
                + step_seconds * config.try_out_steps() as f64,
            train_seconds: step_seconds * config.optimiser.steps as f64 + measuring * measured as f64,
        })
    }
}

/// Seconds that clips take to make. They share moments, which are moved once, where all can be kept.
struct PlanTimes {
    /// For a clip, and for its moments where they are not kept.
    per_clip: f64,
    /// For all moments that are kept.
    for_moments: f64,
}

impl Embedding<'_> {
    /// From the sample, which shows so many moments, to all clips, which show `moments`.
    fn plan_times(&mut self, sampled_moments: usize, moments: usize) -> Result<PlanTimes, EngineError> {
        let (first, made) = (self.seconds["plan"], self.clips.made());
        self.clips.forget_clips();
        let started = Instant::now();
        self.clips.fill(&mut self.buffers)?;
        let again = started.elapsed().as_secs_f64() / (self.clips.made() - made).max(1) as f64;
        let per_moment = (first - again * made as f64).max(0.0) / sampled_moments as f64;
        let bytes = |moments| self.clips.bytes_of_moments(moments);
        if bytes(moments) < moments as u64 * bytes(1) {
            return Ok(PlanTimes { per_clip: first / made.max(1) as f64, for_moments: 0.0 });
        }
        Ok(PlanTimes { per_clip: again, for_moments: per_moment * moments as f64 })
    }

    /// Device bytes of what LPIPS keeps of all clips that its comparisons by these settings come to.
    fn kept_by_lpips(&self, config: &EmbedConfig) -> u64 {
        let (Some(perception), Some(term)) = (self.loss.perception(), config.objective.trained_lpips()) else {
            return 0;
        };
        let (steps, clips) = (config.optimiser.steps, config.views.clips as usize);
        let clip = |step| draw(self.subject.key, config.seed, step, window(step, steps, clips)).0;
        let compared: BTreeSet<usize> = (0..steps).step_by(term.every as usize).map(clip).collect();
        perception.kept_bytes(compared.len())
    }
}
