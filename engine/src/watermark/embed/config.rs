//! What an embedding is asked to do.

use std::sync::Arc;

use guard4d_kernels::image::resize::ImageSize;
use rand_chacha::ChaCha20Rng;
use serde::{Serialize, Serializer};

use super::audition;
use super::ladder::{Aim, Ladder, Rung, name_of_bases};
use super::terms::{Control, ControlClips, LpipsTerm};
use crate::distortion::{Distortion, Drawn};
use crate::error::EngineError;
use crate::render::OffsetBases;
use crate::scene::Vantage;
use crate::scene::gaussians::{MAX_SH_BASES, Y0, sh_bases};
use crate::watermark::evidence::{ExtractorMode, Thresholds};
use crate::watermark::general::GeneralExtractor;
use crate::watermark::mixing::MAX_MIXINGS;
use crate::watermark::prf::{uniform_below, uniform_unit};
use crate::watermark::tmsd::TmsdConfig;

/// Fidelity of both profiles, dB: what the field reports for marks that nobody sees is 40 to 50.
const DEFAULT_TARGET_PSNR: f32 = 43.0;
/// Rate of the DC offsets at that fidelity. Half of it leaves 4 dB unused, and reads fewer bits (demo, robot, fox).
const DEFAULT_LR_DC: f32 = 0.011;
/// Largest offset of `blind` at that fidelity, in colour: 1.15 8-bit steps. Twice as much is 1.4 dB louder and reads no better (robot,
/// 600 steps).
const DEFAULT_MAX_OFFSET: f32 = 0.0045;
/// The same of other extractors, which were not measured with less.
const DEFAULT_MAX_OFFSET_ELSE: f32 = 0.009;
/// Gain of R along an unused colour direction at that fidelity: more saturates CLIP, so that marks made 3.5 times as strong read
/// inverted, and makes rounding loud; less leaves content in. With 3 instead, and marks 3 times as faint, 9 points fewer of single
/// frames' bits were read (demo, robot, fox), with 0.5 three points fewer.
const DEFAULT_NULL_GAIN: f64 = 1.0;
/// Colour level below which a direction counts as unused at that fidelity. Twice as much, and half of it, read fewer bits in two
/// of three scenes.
const DEFAULT_NULL_LEVEL: f64 = 0.01;
/// Standard deviation of the calibration's random offsets at that fidelity, in colour: nine 8-bit steps.
const DEFAULT_RESPONSE_LEVEL: f64 = 0.035;
/// Share of the steps before R of `joint` is trained. On 48 bits (robot, one key, 400 steps) training it from the start read
/// 79.9 % at 50.4 dB, R learning to read a mark that is hardly there; this share reads 88.1 % at 45.1 dB in less time.
const DEFAULT_TMSD_HELD: f32 = 0.5;
/// Steps between two measurements on held-out clips: often enough to watch, seldom enough to cost little.
const DEFAULT_HELD_OUT_EVERY: usize = 25;
/// Copies whose content the calibration of `blind` silences. Where a brighter picture is clamped its colours turn where the asset has none, which R
/// amplifies: an unmarked copy 1.3 times as bright said ten times as much as a mark. Compression, turns and crops move what content says by less than a mark,
/// and cost more as content than they gain (docs/method.md).
const DEFAULT_CALIBRATION_COPIES: [&str; 1] = ["brightness:0.7..1.3"];
/// Clips that are measured and never trained on; two keep a measurement every 25 steps below 5 % of the time.
const HELD_OUT_CLIPS: u32 = 2;
/// As many where they decide what is trained: the share of bits right is then known to one part in a hundred.
const CLIMBING_HELD_OUT: u32 = 8;
/// Steps from one look at these to the next; a look takes as long as some eight steps.
const CLIMBING_EVERY: usize = 50;
/// Share of the light that the splats of the lowest rung carry: the last tenth is spread over very many.
const MOST_LIGHT: f32 = 0.9;
/// Steps on the lowest rung, unless a quarter of all is less.
const RUNG_STEPS: usize = 120;
/// Looks without progress after which a rung is left.
const PATIENCE: u32 = 2;
/// Least fidelity that an embedding can be held to, dB: a hold that never binds.
const UNBOUND_PSNR: f32 = 20.0;
/// How far below the target the hold starts, dB.
const START_SLACK_DB: f32 = 2.0;

/// How much work to spend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// Fast and coarse, for a first look.
    Draft,
    /// The default.
    Balanced,
    /// The objective of Guard4D as printed (its Eqs. 9 to 11 with the weights of its Sec. 4.1), for comparison; with
    /// `joint` the paper's method. What the paper leaves open is as in the other profiles.
    Faithful,
    /// The single-frame baseline of the paper's Table 1 (GuardSplat): the same objective on frames that have nothing to do with
    /// each other; for `none`, without temporal module and control losses.
    Guardsplat,
    /// The multi-frame baseline of that table: likewise, on clips of one camera.
    MultiFrame,
}

impl Profile {
    /// The extractor that a profile is meant for.
    #[must_use]
    pub fn default_mode(self) -> ExtractorMode {
        match self {
            Self::Draft | Self::Balanced => ExtractorMode::Blind,
            Self::Faithful => ExtractorMode::Joint,
            Self::Guardsplat | Self::MultiFrame => ExtractorMode::None,
        }
    }

    /// Whether it takes the paper's objective.
    pub(crate) fn is_the_papers(self) -> bool {
        matches!(self, Self::Faithful | Self::Guardsplat | Self::MultiFrame)
    }
}

/// What a step reads beside the marked clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ControlTurn {
    /// Nothing, and R stays as it was fitted.
    Held,
    /// Nothing.
    Skipped,
    /// The unmarked clip.
    Clean,
    /// The unmarked clip with noise.
    Noisy,
}

/// All numbers of one embedding; written into the receipt.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EmbedConfig {
    /// Profile that the numbers come from.
    pub profile: Profile,
    /// How R is made.
    pub mode: ExtractorMode,
    /// Training steps, one clip each.
    pub steps: usize,
    /// Training clips.
    pub views: u32,
    /// Width and height of training frames in pixels.
    pub size_px: (u32, u32),
    /// Elevations of the training views in degrees above the horizon.
    pub elevation_deg: (f64, f64),
    /// Largest turn of a `joint` training camera around the scene between two frames, in degrees.
    pub turn_deg: f64,
    /// Point that the training views look at, and their distance from it.
    #[serde(flatten)]
    pub vantage: Vantage,
    /// Horizontal field of view in degrees.
    pub fov_deg: f64,
    /// Seed of views, times and noise.
    pub seed: u64,
    /// Fidelity that the offsets are held to at the end, whole frame, dB.
    pub target_psnr: f32,
    /// Fidelity at the start; the hold tightens linearly over the first half.
    pub start_psnr: f32,
    /// SH coefficients that get offsets; `all` means up to the model's degree.
    #[serde(serialize_with = "name_of_bases")]
    pub bases: OffsetBases,
    /// Adam's rate for DC offsets.
    pub lr_dc: f32,
    /// Adam's rate for the other offsets, as a share of `lr_dc` (GuardSplat: 1/20).
    pub lr_rest_share: f32,
    /// Most that an offset may be where all coefficients of degree 3 have one, in colour: what the offset of a DC coefficient adds
    /// to a channel of its splat. Fewer may be larger, so that a splat can change as much: see [`EmbedConfig::largest_offset`]. `None`
    /// bounds them by the fidelity alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_offset: Option<f32>,
    /// Share of the light in the training views that the splats with offsets carry together: the fewest that do. The
    /// others stay as they are. 1 is all splats.
    #[serde(skip_serializing_if = "is_whole")]
    pub reach: f32,
    /// Adam's rate for R in `joint`.
    pub lr_tmsd: f32,
    /// Share of the steps in which R of `joint` stays as it was fitted, at the start: the mark then goes where an R goes that
    /// never saw the message, and training R adds to that. Such steps cost what they cost in `blind`.
    #[serde(skip_serializing_if = "is_zero")]
    pub tmsd_held: f32,
    /// Share of the rates that is left at the end of the cosine.
    pub lr_floor: f32,
    /// Logit beyond which a bit is left alone; 0 takes the paper's BCE instead.
    pub margin: f32,
    /// Weight of the message loss and its controls (Guard4D: 0.03).
    pub lambda_msg: f32,
    /// Weight of the reconstruction loss: L1 and 1 − SSIM (Guard4D: 1). Profiles leave it and the offset penalty at 0
    /// and hold the fidelity at the target instead; a target of 20 dB hardly ever binds.
    pub lambda_recon: f32,
    /// Share of SSIM in the reconstruction loss (GuardSplat: 0.2).
    pub lambda_ssim: f32,
    /// LPIPS, if a network for it was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<LpipsTerm>,
    /// Weight of the offset penalty (Guard4D: 10).
    pub lambda_offset: f32,
    /// Distortions that training draws from, each as often as none at all; the clip and its control go through the same
    /// (expectation over transformations, as in the field's robust variants). Fidelity is that of the undistorted clip.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub distortions: Vec<Distortion>,
    /// Control loss of `joint`.
    pub control: Control,
    /// Clips that it looks at.
    #[serde(skip_serializing_if = "ControlClips::is_both")]
    pub controls: ControlClips,
    /// Weight of each control branch against the message loss.
    pub lambda_control: f32,
    /// Steps from one control to the next, at least 1; more than 1 for `joint` alone. Between them a step reads only the
    /// marked clip, against the logits of the last control, which is cheaper by that control's way through R and CLIP.
    /// Whatever goes back through a control counts this many times, so that over this many steps R's mean gradient stays
    /// what a control in every step would give: with the marked clips' share alone, R would learn to say the message
    /// whatever it sees. Left out of files where it is 1, which is what they meant before there was a choice.
    #[serde(skip_serializing_if = "is_one")]
    pub control_every: u32,
    /// Standard deviation of the noisy control, log-uniform between these.
    pub noise_sigma: (f32, f32),
    /// Mixings that are tried before one is taken for the message, which every p-value then counts; 1 takes the key's first.
    /// More than 1 for `blind` and `general` alone, whose extractors know nothing else of the message.
    #[serde(skip_serializing_if = "is_one")]
    pub mixings: u32,
    /// Size of R in `blind` and `joint`.
    pub tmsd: TmsdConfig,
    /// What `general` reads through, and it alone; files name its hash.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "hash_of_general")]
    pub general: Option<Arc<GeneralExtractor>>,
    /// Gain of R along the colour direction that the unmarked asset uses least.
    pub null_gain: f64,
    /// Colour level below which a direction counts as unused.
    pub null_level: f64,
    /// Random offset fields that the calibration is fitted to; `general` has none of its own.
    pub responses: usize,
    /// Standard deviation of these fields, in colour.
    pub response_level: f64,
    /// Copies of unmarked clips that the calibration counts as content too, at both ends of each range.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub calibration_copies: Vec<Distortion>,
    /// Steps between two measurements on held-out clips; 0 for none. It changes no result, so that it is no part of
    /// what names one. A ladder has looks of its own instead.
    #[serde(skip)]
    pub held_out_every: usize,
    /// Rungs that training climbs, and when it ends before its last step; `None` takes all steps, with everything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ladder: Option<Ladder>,
}

impl EmbedConfig {
    /// The numbers of a profile.
    #[must_use]
    pub fn new(profile: Profile, mode: ExtractorMode) -> Self {
        let (steps, views, size, responses) = match profile {
            Profile::Draft => (600, 96, 200, 64),
            Profile::Balanced => (900, 144, 400, 64),
            // 100 epochs of 200 frames are 25 clips of eight; a pool of clips stands for views that are drawn anew.
            Profile::Faithful | Profile::Guardsplat | Profile::MultiFrame => (2500, 144, 400, 64),
        };
        let config = Self {
            profile,
            mode,
            steps,
            views,
            size_px: (size, size),
            elevation_deg: (5.0, 65.0),
            turn_deg: 12.0,
            vantage: Vantage::D_NERF,
            fov_deg: 39.6,
            seed: 0,
            target_psnr: 0.0,
            start_psnr: 0.0,
            bases: OffsetBases::All,
            lr_dc: 0.0,
            lr_rest_share: 0.05,
            max_offset: None,
            reach: 1.0,
            lr_tmsd: 1e-3,
            tmsd_held: if mode == ExtractorMode::Joint { DEFAULT_TMSD_HELD } else { 0.0 },
            lr_floor: 0.05,
            margin: 0.0,
            lambda_msg: 1.0,
            lambda_recon: 0.0,
            lambda_ssim: 0.2,
            lpips: None,
            distortions: Vec::new(),
            calibration_copies: match mode {
                ExtractorMode::Blind if !profile.is_the_papers() => default_calibration_copies(),
                _ => Vec::new(),
            },
            lambda_offset: 0.0,
            control: Control::InverseBce { eps: 0.5 },
            controls: ControlClips::Both,
            lambda_control: 0.05,
            control_every: 1,
            noise_sigma: (0.002, 0.05),
            mixings: 1,
            tmsd: match mode {
                ExtractorMode::Joint => TmsdConfig::default(),
                _ => TmsdConfig::colour_map_only(),
            },
            general: None,
            null_gain: 0.0,
            null_level: 0.0,
            responses: 0,
            response_level: 0.0,
            held_out_every: DEFAULT_HELD_OUT_EVERY,
            ladder: None,
        }
        .sized_for(DEFAULT_TARGET_PSNR)
        .with_responses(responses);
        if profile.is_the_papers() { config.with_the_papers_objective() } else { config }
    }

    /// Weights and rates of Guard4D's Sec. 4.1; the fidelity is whatever they make it.
    fn with_the_papers_objective(self) -> Self {
        Self {
            target_psnr: UNBOUND_PSNR,
            start_psnr: UNBOUND_PSNR,
            bases: OffsetBases::All,
            lr_dc: 5e-3,
            lr_rest_share: 0.05,
            max_offset: None,
            tmsd_held: 0.0,
            lr_floor: 1.0,
            margin: 0.0,
            lambda_msg: 0.03,
            lambda_recon: 1.0,
            lambda_ssim: 0.2,
            lambda_offset: 10.0,
            // One control a step stands for both, so that it counts twice.
            lambda_control: 2.0,
            ..self
        }
    }

    /// Whether the frames of a training clip are of one camera, which turns.
    pub(super) fn films(&self) -> bool {
        self.mode == ExtractorMode::Joint || self.profile == Profile::MultiFrame
    }

    /// The same with another fidelity, and with everything that is measured in colour in proportion to it: the rate of
    /// the offsets, the level of the random fields, and R, which looks for marks of this size and shows CLIP the same
    /// contrast whatever the size is. (With R left as it is, marks of 38 dB and below read worse than weaker ones.) The
    /// paper's objective keeps its rates; the fidelity is held besides.
    #[must_use]
    pub fn with_target(self, target_psnr: f32) -> Self {
        if self.profile.is_the_papers() {
            return Self { target_psnr, start_psnr: (target_psnr - START_SLACK_DB).max(UNBOUND_PSNR), ..self };
        }
        self.sized_for(target_psnr)
    }

    /// The same with so many random fields, unless it takes none.
    #[must_use]
    pub fn with_responses(self, responses: usize) -> Self {
        match self.mode {
            ExtractorMode::General => self,
            _ => Self { responses, ..self },
        }
    }

    /// The same with so many mixings to choose from, where the mode has a choice.
    #[must_use]
    pub fn with_mixings(self, mixings: u32) -> Self {
        if self.can_choose_mixings() { Self { mixings, ..self } } else { self }
    }

    fn sized_for(self, target_psnr: f32) -> Self {
        let amplitude = 10f32.powf((DEFAULT_TARGET_PSNR - target_psnr) / 20.0);
        let max_offset = match self.mode {
            ExtractorMode::Blind | ExtractorMode::General => DEFAULT_MAX_OFFSET,
            _ => DEFAULT_MAX_OFFSET_ELSE,
        };
        Self {
            target_psnr,
            start_psnr: target_psnr - START_SLACK_DB,
            lr_dc: DEFAULT_LR_DC * amplitude,
            null_gain: DEFAULT_NULL_GAIN / f64::from(amplitude),
            null_level: DEFAULT_NULL_LEVEL * f64::from(amplitude),
            response_level: DEFAULT_RESPONSE_LEVEL * f64::from(amplitude),
            max_offset: Some(max_offset * amplitude),
            ..self
        }
    }

    /// The same, but no more of it than the asset needs. Training begins with a short run on the splats that carry most of
    /// the light and half of the views, in which the rates go down to their floor; where held-out clips then fall short of
    /// what `aim` asks for at the target fidelity, it goes on with all of them, for twice as long, and then with looks on the
    /// way for the rest. A mark whose rates are still high is noise in good part: looked at on the way only, the same took two
    /// to three times the steps. The fidelity is held from the start, so that the end can be soon, and the calibration makes
    /// do with half of the random fields.
    ///
    /// The extractor stays of its mode; R of `joint` is trained from the start, since a short run would end before its turn.
    /// The bases stay too: with DC terms first, and the others on a rung of their own, more steps were needed.
    #[must_use]
    pub fn climbing(self, aim: Aim, bits: usize) -> Self {
        let rung = |reach: f32, views: u32, steps: usize| Rung { bases: self.bases, reach, views, steps };
        let first = RUNG_STEPS.min(self.steps.div_ceil(4));
        let most = self.reach.min(MOST_LIGHT);
        let rungs = vec![
            rung(most, self.views.div_ceil(2), first),
            rung(self.reach, self.views, 2 * first),
            // Nothing is left for later on the last one: with 100 steps there, fox was left at 82 % of bits instead of 95 %.
            rung(self.reach, self.views, self.steps.saturating_sub(3 * first).max(1)),
        ];
        let ladder =
            Some(Ladder { rungs, aim, every: CLIMBING_EVERY, patience: PATIENCE, held_out: CLIMBING_HELD_OUT });
        let responses = self.responses.div_ceil(2).max(bits);
        Self { start_psnr: self.target_psnr, tmsd_held: 0.0, ladder, ..self }.with_responses(responses)
    }

    /// Most that the offset of a coefficient of a model of this degree may be, if there is a bound.
    ///
    /// # Equation: √(16/B) `max_offset` / Y₀
    /// for B coefficients with offsets. The sum of the squares of all bases is the same in every direction, so that the root of the
    /// mean square of what offsets at their bounds add to a colour is the same for every B. With the bound of 16 the DC terms alone came
    /// out at 56 dB, and read 81 % of single frames' bits; with four times as much 48 dB and 85 % (demo, 16 bits, one key).
    #[must_use]
    pub fn largest_offset(&self, sh_degree: u32) -> Option<f64> {
        let used = match self.bases {
            OffsetBases::Dc => sh_bases(0),
            OffsetBases::All => sh_bases(sh_degree),
        };
        self.max_offset.map(|colour| (MAX_SH_BASES as f64 / used as f64).sqrt() * f64::from(colour) / Y0)
    }

    /// The settings for a model of this degree: without coefficients above DC there is no room to take for them.
    pub(super) fn for_degree(mut self, sh_degree: u32) -> Self {
        if sh_degree == 0 {
            self.bases = OffsetBases::Dc;
            self.ladder.iter_mut().flat_map(|ladder| &mut ladder.rungs).for_each(|rung| rung.bases = OffsetBases::Dc);
        }
        self
    }

    /// The settings on a rung of the ladder, or all of them where there is none.
    pub(super) fn on_rung(&self, number: usize) -> Self {
        match self.ladder.as_ref().and_then(|ladder| ladder.rungs.get(number)) {
            Some(Rung { bases, reach, views, .. }) => {
                Self { bases: *bases, reach: *reach, views: *views, ..self.clone() }
            }
            None => self.clone(),
        }
    }

    /// Most measurements on held-out clips that its steps can come with.
    pub(super) fn most_looks(&self) -> usize {
        match (&self.ladder, self.held_out_every) {
            (Some(ladder), _) => ladder.rungs.len() + self.steps / ladder.every,
            (None, 0) => 0,
            (None, every) => self.steps.div_ceil(every),
        }
    }

    /// Clips that no step is taken on.
    pub(super) fn held_out_clips(&self) -> u32 {
        match &self.ladder {
            Some(ladder) => ladder.held_out,
            None if self.held_out_every > 0 => HELD_OUT_CLIPS,
            None => 0,
        }
    }

    /// False-positive rate at which held-out clips prove a message of `bits` bits.
    pub(super) fn proof(&self, bits: usize) -> f64 {
        let alone = || Thresholds::for_bits(bits).fpr / f64::from(self.mixings);
        self.ladder.as_ref().map_or_else(alone, |ladder| ladder.aim.p_value)
    }

    /// Whether splats have rates of their own.
    pub(super) fn rates_differ(&self) -> bool {
        let reaches = self.ladder.iter().flat_map(|ladder| &ladder.rungs).map(|rung| rung.reach);
        reaches.chain([self.reach]).any(|reach| reach < 1.0)
    }

    /// Whether SSIM is part of the loss.
    pub(super) fn uses_ssim(&self) -> bool {
        self.lambda_recon > 0.0 && self.lambda_ssim > 0.0
    }

    /// LPIPS, if it is part of the loss.
    pub(super) fn trained_lpips(&self) -> Option<&LpipsTerm> {
        self.lpips.as_ref().filter(|term| term.lambda > 0.0)
    }

    /// Whether the loss has a part that looks at the pixels of whole frames.
    pub(super) fn looks_at_pixels(&self) -> bool {
        self.lambda_recon > 0.0 || self.trained_lpips().is_some()
    }

    /// Size of training frames.
    pub(super) fn frame_size(&self) -> ImageSize {
        ImageSize { height: self.size_px.1 as usize, width: self.size_px.0 as usize }
    }

    /// What step number `step` reads beside the marked clip if it trains R: every `control_every`-th step has a control,
    /// by turns clean and noisy if both are asked for.
    pub(super) fn control_turn(&self, step: usize) -> ControlTurn {
        let every = self.control_every as usize;
        let Some(step) = step.checked_sub(self.held_steps()) else { return ControlTurn::Held };
        if !step.is_multiple_of(every) {
            return ControlTurn::Skipped;
        }
        match (self.controls, (step / every).is_multiple_of(2)) {
            (ControlClips::Clean, _) | (ControlClips::Both, true) => ControlTurn::Clean,
            (ControlClips::Noisy, _) | (ControlClips::Both, false) => ControlTurn::Noisy,
        }
    }

    /// Steps before R is trained.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    fn held_steps(&self) -> usize {
        (self.tmsd_held * self.steps as f32) as usize
    }

    /// Whether some steps read the marked clip alone, and others a control too.
    pub(super) fn goes_without_control(&self) -> bool {
        self.mode == ExtractorMode::Joint && (self.control_every > 1 || self.held_steps() > 0)
    }

    /// First row and column of what step number `step` compares by LPIPS, if it does.
    pub(super) fn lpips_turn(&self, step: usize, rng: &mut ChaCha20Rng) -> Option<[usize; 2]> {
        let term = self.trained_lpips().filter(|term| step.is_multiple_of(term.every as usize))?;
        let (frame, part) = (self.frame_size(), term.part_of(self.frame_size()));
        let mut first = |whole: usize, part: usize| match u32::try_from(whole - part) {
            Ok(0) | Err(_) => 0,
            Ok(spare) => uniform_below(rng, spare + 1) as usize,
        };
        Some([first(frame.height, part.height), first(frame.width, part.width)])
    }

    /// What the clip of step number `step` goes through before CLIP sees it, if anything.
    pub(super) fn distortion_turn(&self, step: usize, rng: &mut ChaCha20Rng) -> Option<Drawn> {
        let kinds = u32::try_from(self.distortions.len()).ok().filter(|n| *n > 0)?;
        let index = uniform_below(rng, kinds + 1) as usize;
        let share = uniform_unit(rng);
        let stream = u32::try_from(step).unwrap_or(u32::MAX);
        (index < self.distortions.len()).then_some(Drawn { index, share, seed: !self.seed, stream })
    }

    /// Steps after which controls and LPIPS come in the same order again.
    pub(super) fn round(&self) -> usize {
        let every = self.trained_lpips().map_or(1, |term| term.every) as usize;
        let control = self.control_every as usize;
        (1..=every).map(|times| times * control).find(|steps| steps.is_multiple_of(every)).unwrap_or(control)
    }

    /// Clips that the extractor reads in a step with a control: the marked one and, for `joint`, that control.
    pub(super) fn branches(&self) -> usize {
        if self.mode == ExtractorMode::Joint { 2 } else { 1 }
    }

    /// Whether the mixing is all that the extractor can have of the message.
    fn can_choose_mixings(&self) -> bool {
        matches!(self.mode, ExtractorMode::Blind | ExtractorMode::General)
    }

    /// Steps of all try-outs of mixings.
    pub(super) fn try_out_steps(&self) -> usize {
        if self.mixings > 1 { self.mixings as usize * audition::STEPS } else { 0 }
    }

    /// Refuses numbers that no embedding can work with.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the field.
    pub fn validate(&self) -> Result<(), EngineError> {
        self.tmsd.validate()?;
        if self.mode == ExtractorMode::Joint && self.tmsd.depth == 0 {
            return Err(EngineError::Usage {
                what: "TMSD depth".to_owned(),
                got: "0".to_owned(),
                expected: "at least 2 for `joint`, which trains it".to_owned(),
            });
        }
        self.validate_general()?;
        if self.control_every == 0 || (self.control_every > 1 && self.mode != ExtractorMode::Joint) {
            return Err(EngineError::Usage {
                what: "control_every".to_owned(),
                got: self.control_every.to_string(),
                expected: "at least 1, and 1 for all but `joint`, which alone has controls".to_owned(),
            });
        }
        self.validate_mixings()?;
        if let Some(ladder) = self.ladder.as_ref().filter(|ladder| !ladder.is_sensible(self.views)) {
            return Err(EngineError::Usage {
                what: "ladder".to_owned(),
                got: format!("{ladder:?}"),
                expected:
                    "rungs that each have as much as the one below, a p-value and a share from 0 to 1, and no zeros"
                        .to_owned(),
            });
        }
        if let Some(term) = &self.lpips {
            term.validate(self.frame_size())?;
        }
        let checks = [
            ("steps", self.steps as f64, self.steps > 0),
            ("views", f64::from(self.views), self.views > 0),
            ("target PSNR", f64::from(self.target_psnr), (UNBOUND_PSNR..=80.0).contains(&self.target_psnr)),
            ("radius", self.vantage.radius, self.vantage.radius.is_finite() && self.vantage.radius > 0.0),
            weight("lambda_msg", self.lambda_msg),
            weight("lambda_recon", self.lambda_recon),
            weight("lambda_offset", self.lambda_offset),
            weight("lambda_control", self.lambda_control),
            weight("lr_dc", self.lr_dc),
            weight("lr_rest_share", self.lr_rest_share),
            weight("max_offset", self.max_offset.unwrap_or(0.0)),
            weight("lr_floor", self.lr_floor),
            weight("margin", self.margin),
            ("reach", f64::from(self.reach), self.reach > 0.0 && self.reach <= 1.0),
            ("tmsd_held", f64::from(self.tmsd_held), (0.0..1.0).contains(&self.tmsd_held)),
            ("lambda_ssim", f64::from(self.lambda_ssim), (0.0..=1.0).contains(&self.lambda_ssim)),
        ];
        for (what, got, fine) in checks {
            if !fine {
                return Err(EngineError::Usage {
                    what: what.to_owned(),
                    got: got.to_string(),
                    expected: "a sensible number, not negative (PSNR: 20 to 80 dB; reach: at most 1)".to_owned(),
                });
            }
        }
        Ok(())
    }

    fn validate_mixings(&self) -> Result<(), EngineError> {
        let most = if self.can_choose_mixings() { MAX_MIXINGS } else { 1 };
        if (1..=most).contains(&self.mixings) {
            return Ok(());
        }
        Err(EngineError::Usage {
            what: "mixings".to_owned(),
            got: format!("{} with mode `{}`", self.mixings, self.mode),
            expected: format!("1 to {MAX_MIXINGS} with `blind` and `general`, else 1"),
        })
    }

    fn validate_general(&self) -> Result<(), EngineError> {
        if self.general.is_some() != (self.mode == ExtractorMode::General) {
            return Err(EngineError::Usage {
                what: "general extractor".to_owned(),
                got: format!("{} with mode `{}`", if self.general.is_some() { "one" } else { "none" }, self.mode),
                expected: "one with mode `general`, and with no other".to_owned(),
            });
        }
        Ok(())
    }

    /// [`EmbedConfig::validate`], and that a message of `bits` bits can be calibrated.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the field.
    pub fn validate_for(&self, bits: usize) -> Result<(), EngineError> {
        self.validate()?;
        let expected = match self.mode {
            ExtractorMode::General if self.responses > 0 => "none with mode `general`".to_owned(),
            ExtractorMode::General => return Ok(()),
            _ if self.responses < bits => format!("at least one per bit, {bits}"),
            _ => return Ok(()),
        };
        Err(EngineError::Usage { what: "responses".to_owned(), got: self.responses.to_string(), expected })
    }
}

/// A check of [`EmbedConfig::validate`].
fn weight(name: &'static str, value: f32) -> (&'static str, f64, bool) {
    (name, f64::from(value), value.is_finite() && value >= 0.0)
}

fn default_calibration_copies() -> Vec<Distortion> {
    DEFAULT_CALIBRATION_COPIES.iter().map(|text| text.parse().expect("a distortion")).collect()
}

#[allow(clippy::ref_option, reason = "serde's signature")]
fn hash_of_general<S: Serializer>(general: &Option<Arc<GeneralExtractor>>, serializer: S) -> Result<S::Ok, S::Error> {
    let hash = general.as_ref().map(|general| general.digest()).transpose();
    hash.map_err(serde::ser::Error::custom)?.serialize(serializer)
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_one(number: &u32) -> bool {
    *number == 1
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_zero(share: &f32) -> bool {
    *share <= 0.0
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_whole(share: &f32) -> bool {
    *share >= 1.0
}
