//! All numbers of one embedding.

use guard4d_kernels::shape::OffsetBases;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::extractor::Extractor;
use super::fidelity::{Fidelity, UNBOUND_PSNR};
use super::objective::Objective;
use super::optimiser::{DEFAULT_HELD_OUT_EVERY, Optimiser};
use super::profile::Profile;
use super::schedule::{AdaptiveSchedule, Aim, Phase};
use super::training_views::{FramingChoice, TrainingViews};
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::evidence::thresholds::Thresholds;

/// Fidelity of both profiles, dB: what the field reports for marks that nobody sees is 40 to 50.
const DEFAULT_TARGET_PSNR: f32 = 43.0;
/// What the owner's chips take of it, dB.
const DEFAULT_CHIPS_DB: f32 = 0.3;
/// Rate of the DC offsets at that fidelity. Half of it leaves 4 dB unused, and reads fewer bits (demo, robot, fox).
const DEFAULT_LR_DC: f32 = 0.011;
/// Largest offset of `blind` at that fidelity, in colour: 1.15 8-bit steps. Twice as much is 1.4 dB louder and reads no
/// better (robot, 600 steps).
const DEFAULT_MAX_OFFSET: f32 = 0.0045;
/// The same of other extractors, which were not measured with less.
const DEFAULT_MAX_OFFSET_ELSE: f32 = 0.009;
/// Gain of R along an unused colour direction at that fidelity: more saturates CLIP, so that marks made 3.5 times as
/// strong read inverted, and makes rounding loud; less leaves content in. With 3 instead, and marks 3 times as faint, 9
/// points fewer of single frames' bits were read (demo, robot, fox), with 0.5 three points fewer.
const DEFAULT_NULL_GAIN: f64 = 1.0;
/// Colour level below which a direction counts as unused at that fidelity. Twice as much, and half of it, read fewer
/// bits in two of three scenes.
const DEFAULT_NULL_LEVEL: f64 = 0.01;
/// Standard deviation of the calibration's random offsets at that fidelity, in colour: nine 8-bit steps.
const DEFAULT_PROBE_LEVEL: f64 = 0.035;
/// Clips that are evaluated and never trained on; two keep an evaluation every 25 steps below 5 % of the time.
const HELD_OUT_CLIPS: u32 = 2;
/// As many where they decide what is trained: the share of bits right is then known to one part in a hundred.
const ADAPTIVE_HELD_OUT: u32 = 8;
/// Steps from one evaluation of these to the next; one takes as long as some eight steps.
const ADAPTIVE_EVERY: usize = 50;
/// Share of the visible light that the splats of the first phase carry: the last tenth is spread over very many.
const FIRST_VISIBILITY: f32 = 0.9;
/// Steps of the first phase, unless a quarter of all is less.
const FIRST_STEPS: usize = 120;
/// Evaluations without progress after which the last phase ends.
const PATIENCE: u32 = 2;
/// How far below the target the hold starts, dB.
const START_SLACK_DB: f32 = 2.0;

/// All numbers of one embedding; written into the receipt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EmbedConfig {
    /// Profile that the numbers come from.
    pub profile: Profile,
    /// Seed of views, times and noise.
    pub seed: u64,
    /// Where training looks at the scene from.
    pub views: TrainingViews,
    /// How faint the mark is, and where it may be.
    pub fidelity: Fidelity,
    /// What training makes small.
    pub objective: Objective,
    /// How it does that.
    pub optimiser: Optimiser,
    /// What frames are read through.
    pub extractor: Extractor,
    /// Phases of training, and when it ends before its last step; `None` takes all steps, with everything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub schedule: Option<AdaptiveSchedule>,
}

impl EmbedConfig {
    /// The numbers of a profile. A pretrained extractor is the built-in one, and has to be
    /// [opened](EmbedConfig::open_weights).
    #[must_use]
    pub fn new(profile: Profile, mode: ExtractorMode) -> Self {
        let learns_views = matches!(mode, ExtractorMode::Blind | ExtractorMode::Pretrained);
        let (steps, clips) = match profile {
            // A mark that reads alike from all views learns more from a new one than from one it knows.
            Profile::Draft if learns_views => (240, 240),
            Profile::Balanced if learns_views => (360, 360),
            Profile::Draft => (600, 96),
            Profile::Balanced => (900, 144),
            // 100 epochs of 200 frames are 25 clips of eight; a pool of clips stands for views that are drawn anew.
            Profile::Faithful | Profile::Guardsplat | Profile::MultiFrame => (2500, 144),
        };
        let config = Self {
            profile,
            seed: 0,
            views: TrainingViews::new((400, 400), clips),
            fidelity: Fidelity {
                target_psnr: 0.0,
                start_psnr: 0.0,
                bases: OffsetBases::All,
                max_offset: None,
                visibility_share: 1.0,
                chips_db: DEFAULT_CHIPS_DB,
            },
            objective: Objective {
                distortions: Vec::new(),
                margin: 0.0,
                lambda_msg: 1.0,
                lambda_recon: 0.0,
                lambda_ssim: 0.2,
                lambda_offset: 0.0,
                noise_sigma: (0.002, 0.05),
                lpips: None,
            },
            optimiser: Optimiser {
                steps,
                lr_dc: 0.0,
                lr_rest_share: 0.05,
                lr_floor: 0.05,
                held_out_every: DEFAULT_HELD_OUT_EVERY,
            },
            extractor: Extractor::new(profile, mode),
            schedule: None,
        }
        .sized_for(DEFAULT_TARGET_PSNR);
        // What the paper says is compared as it says it; R of `joint` learns from films of one camera.
        let config = config.with(|config| {
            if profile.is_the_papers() || mode == ExtractorMode::Joint {
                config.views.framing = FramingChoice::Whole;
            }
        });
        if profile.is_the_papers() { config.with_the_papers_objective() } else { config }
    }

    /// The same with a change.
    ///
    /// ```
    /// # use guard4d_engine::evidence::extractor_mode::ExtractorMode;
    /// # use guard4d_engine::watermark::embed::{EmbedConfig, Profile};
    /// let few = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind).with(|config| config.optimiser.steps = 3);
    /// assert_eq!(few.optimiser.steps, 3);
    /// ```
    #[must_use]
    pub fn with(mut self, change: impl FnOnce(&mut Self)) -> Self {
        change(&mut self);
        self
    }

    /// Weights and rates of Guard4D's Sec. 4.1; the fidelity is whatever they make it.
    fn with_the_papers_objective(self) -> Self {
        self.with(|config| {
            (config.fidelity.target_psnr, config.fidelity.start_psnr) = (UNBOUND_PSNR, UNBOUND_PSNR);
            (config.fidelity.max_offset, config.fidelity.chips_db) = (None, 0.0);
            (config.optimiser.lr_dc, config.optimiser.lr_floor) = (5e-3, 1.0);
            config.objective.lambda_msg = 0.03;
            config.objective.lambda_recon = 1.0;
            config.objective.lambda_offset = 10.0;
        })
    }

    /// How R is made.
    #[must_use]
    pub fn mode(&self) -> ExtractorMode {
        self.extractor.mode()
    }

    /// Whether the frames of a training clip are of one camera, which turns.
    pub(in super::super) fn films(&self) -> bool {
        self.mode() == ExtractorMode::Joint || self.profile == Profile::MultiFrame
    }

    /// The same with another fidelity, and with everything that is measured in colour in proportion to it: the rate of
    /// the offsets, the level of the random fields, and R, which looks for marks of this size and shows CLIP the same
    /// contrast whatever the size is. (With R left as it is, marks of 38 dB and below read worse than weaker ones.) The
    /// paper's objective keeps its rates; the fidelity is held besides.
    #[must_use]
    pub fn with_target(self, target_psnr: f32) -> Self {
        if self.profile.is_the_papers() {
            let start_psnr = (target_psnr - START_SLACK_DB).max(UNBOUND_PSNR);
            return self.with(|c| (c.fidelity.target_psnr, c.fidelity.start_psnr) = (target_psnr, start_psnr));
        }
        self.sized_for(target_psnr)
    }

    /// The same with so many random fields, unless it takes none.
    #[must_use]
    pub fn with_probes(self, probes: usize) -> Self {
        self.with(|config| config.extractor.calibration_mut().into_iter().for_each(|c| c.probes = probes))
    }

    /// The same with so many rotations to choose from, where the mode has a choice.
    #[must_use]
    pub fn with_rotations(self, rotations: u32) -> Self {
        self.with(|config| config.extractor.rotations_mut().into_iter().for_each(|r| *r = rotations))
    }

    fn sized_for(mut self, target_psnr: f32) -> Self {
        let amplitude = 10f32.powf((DEFAULT_TARGET_PSNR - target_psnr) / 20.0);
        let max_offset = match self.mode() {
            ExtractorMode::Blind | ExtractorMode::Pretrained => DEFAULT_MAX_OFFSET,
            ExtractorMode::None | ExtractorMode::Joint => DEFAULT_MAX_OFFSET_ELSE,
        };
        self.fidelity.target_psnr = target_psnr;
        self.fidelity.start_psnr = target_psnr - START_SLACK_DB;
        self.fidelity.max_offset = Some(max_offset * amplitude);
        self.optimiser.lr_dc = DEFAULT_LR_DC * amplitude;
        if let Some(colours) = self.extractor.colours_mut() {
            colours.null_gain = DEFAULT_NULL_GAIN / f64::from(amplitude);
            colours.null_level = DEFAULT_NULL_LEVEL * f64::from(amplitude);
        }
        if let Some(calibration) = self.extractor.calibration_mut() {
            calibration.probe_level = DEFAULT_PROBE_LEVEL * f64::from(amplitude);
        }
        self
    }

    /// The same, but no more of it than the asset needs. Training begins with a short run on the splats that carry most
    /// of the light and half of the clips, in which the rates go down to their floor; where held-out clips then fall
    /// short of what `aim` asks for at the target fidelity, it goes on with all of them, for twice as long, and then
    /// with evaluations on the way for the rest. A mark whose rates are still high is noise in good part: evaluated on
    /// the way only, the same took two to three times the steps. The fidelity is held from the start, so that the end
    /// can be soon, and the calibration makes do with half of the random fields.
    ///
    /// The extractor stays of its mode; R of `joint` is trained from the start, since a short run would end before its
    /// turn. The bases stay too: with DC terms first, and the others in a phase of their own, more steps were needed.
    #[must_use]
    pub fn adaptive(mut self, aim: Aim, bits: usize) -> Self {
        let (clips, steps, share) = (self.views.clips, self.optimiser.steps, self.fidelity.visibility_share);
        let bases = self.fidelity.bases;
        let phase = |visibility_share: f32, clips: u32, steps: usize| Phase { bases, visibility_share, clips, steps };
        let first = FIRST_STEPS.min(steps.div_ceil(4));
        let phases = vec![
            phase(share.min(FIRST_VISIBILITY), clips.div_ceil(2), first),
            phase(share, clips, 2 * first),
            // Nothing is left for later in the last one: with 100 steps there, fox was left at 82 % of bits instead of
            // 95 %.
            phase(share, clips, steps.saturating_sub(3 * first).max(1)),
        ];
        let (every, patience, held_out) = (ADAPTIVE_EVERY, PATIENCE, ADAPTIVE_HELD_OUT);
        self.schedule = Some(AdaptiveSchedule { every, patience, held_out, aim, phases });
        self.fidelity.start_psnr = self.fidelity.target_psnr;
        if let Some(joint) = self.extractor.joint_mut() {
            joint.tmsd_held = 0.0;
        }
        let probes = self.extractor.probes().div_ceil(2).max(bits);
        self.with_probes(probes)
    }

    /// The settings for a model of this degree: without coefficients above DC there is no room to take for them.
    pub(in super::super) fn for_degree(mut self, sh_degree: u32) -> Self {
        if sh_degree == 0 {
            self.fidelity.bases = OffsetBases::Dc;
            let phases = self.schedule.iter_mut().flat_map(|schedule| &mut schedule.phases);
            phases.for_each(|phase| phase.bases = OffsetBases::Dc);
        }
        self
    }

    /// The settings in a phase of the schedule, or all of them where there is none.
    pub(in super::super) fn in_phase(&self, number: usize) -> Self {
        let phase = self.schedule.as_ref().and_then(|schedule| schedule.phases.get(number));
        self.clone().with(|config| {
            if let Some(Phase { bases, visibility_share, clips, .. }) = phase {
                (config.fidelity.bases, config.fidelity.visibility_share) = (*bases, *visibility_share);
                config.views.clips = *clips;
            }
        })
    }

    /// Most evaluations of held-out clips that its steps can come with.
    pub(in super::super) fn most_evaluations(&self) -> usize {
        let steps = self.optimiser.steps;
        match (&self.schedule, self.optimiser.held_out_every) {
            (Some(schedule), _) => schedule.phases.len() + steps / schedule.every,
            (None, 0) => 0,
            (None, every) => steps.div_ceil(every),
        }
    }

    /// Clips that no step is taken on.
    pub(in super::super) fn held_out_clips(&self) -> u32 {
        match &self.schedule {
            Some(schedule) => schedule.held_out,
            None if self.optimiser.held_out_every > 0 => HELD_OUT_CLIPS,
            None => 0,
        }
    }

    /// False-positive rate at which held-out clips prove a message of `bits` bits.
    pub(in super::super) fn proof(&self, bits: usize) -> f64 {
        let alone = || Thresholds::for_bits(bits).fpr / f64::from(self.extractor.rotations());
        self.schedule.as_ref().map_or_else(alone, |schedule| schedule.aim.p_value)
    }

    /// Whether splats have rates of their own.
    pub(in super::super) fn rates_differ(&self) -> bool {
        let phases = self.schedule.iter().flat_map(|schedule| &schedule.phases);
        let shares = phases.map(|phase| phase.visibility_share).chain([self.fidelity.visibility_share]);
        shares.into_iter().any(|share| share < 1.0)
    }

    /// Opens the networks that the settings name, and notes their hashes.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] or [`EngineError::BadData`] naming the file; [`EngineError::BadData`] too for a
    /// file of another hash than the settings have.
    pub fn open_weights(&mut self) -> Result<(), EngineError> {
        if let Extractor::Pretrained(pretrained) = &mut self.extractor {
            pretrained.weights.open()?;
        }
        self.objective.lpips.as_mut().map_or(Ok(()), |term| term.network.open())
    }

    /// The settings as receipts hold them, single precision written with no more digits than it has.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let text = serde_json::to_string(self).expect("numbers and words are valid JSON");
        serde_json::from_str(&text).expect("it was written as JSON")
    }

    /// What names an embedding with these settings, wherever its files lie.
    #[must_use]
    pub fn identity(&self) -> String {
        let anywhere = self.clone().with(|config| {
            if let Extractor::Pretrained(pretrained) = &mut config.extractor {
                pretrained.weights.forget_path();
            }
            config.objective.lpips.iter_mut().for_each(|term| term.network.forget_path());
        });
        anywhere.to_json().to_string()
    }

    /// Refuses numbers that no embedding can work with, whatever networks the settings name.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the field.
    pub fn validate_numbers(&self) -> Result<(), EngineError> {
        self.views.validate()?;
        self.fidelity.validate()?;
        self.objective.validate()?;
        self.optimiser.validate()?;
        self.extractor.validate()?;
        self.schedule.as_ref().map_or(Ok(()), |schedule| schedule.validate(self.views.clips))
    }

    /// [`EmbedConfig::validate_numbers`], and that all networks are open and can be used.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the field.
    pub fn validate(&self) -> Result<(), EngineError> {
        self.validate_numbers()?;
        if let Extractor::Pretrained(pretrained) = &self.extractor {
            pretrained.weights.get()?;
        }
        let frame = self.views.frame_size();
        self.objective.lpips.as_ref().map_or(Ok(()), |term| term.validate_network(frame))
    }

    /// [`EmbedConfig::validate`], and that a message of `bits` bits can be calibrated.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the field.
    pub fn validate_for(&self, bits: usize) -> Result<(), EngineError> {
        self.validate()?;
        self.extractor.validate_for(bits)
    }
}
