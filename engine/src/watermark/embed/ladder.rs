//! No more than a scene needs: starting with little, adding more where held-out clips ask for it, and ending in time.
//!
//! No rung changes the extractor: that of `joint` is trained with the message and gives no exact p-value, which is for
//! whoever embeds to choose.

use serde::{Deserialize, Serialize, Serializer};

use super::config::EmbedConfig;
use super::step::HeldOutReport;
use crate::render::OffsetBases;
use crate::train::schedule::cosine;
use crate::watermark::metrics::Decibels;

/// Steps that are taken after the last rung while the rates fall to their floor, which settles the mark.
const SETTLING_STEPS: usize = 25;
/// Fidelity that may be missing when a look finds the mark good enough, dB; the hold makes up for it while the mark settles.
const PSNR_SLACK_DB: f32 = 0.25;
/// Fidelity that may be left over, dB, for a look without progress to count: a mark that still grows is not done.
const GROWN_DB: f32 = 0.5;
/// Share of the held-out frames' bits by which a look must beat the best one before it to count as progress: one standard
/// error of a share of 0.95 among the 1024 bits of eight clips that read 16 is 0.007.
const GAIN: f32 = 0.007;

/// What is trained from some step on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Rung {
    /// SH coefficients that have offsets; never fewer than on the rung below.
    #[serde(serialize_with = "name_of_bases")]
    pub bases: OffsetBases,
    /// As [`EmbedConfig::reach`]; never less than on the rung below.
    pub reach: f32,
    /// Training clips, the first of [`EmbedConfig::views`]; never fewer than on the rung below.
    pub views: u32,
    /// Most steps on this rung; on all but the last, all of its steps, in which the rates go down their cosine once.
    pub steps: usize,
}

/// What held-out clips must show for a mark to be good enough.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Aim {
    /// Largest p-value of a clip that proves the message alone, see [`HeldOutReport::proven`].
    pub p_value: f64,
    /// Least share of the clips that do.
    pub proven: f64,
    /// Least share of the message's bits right, see [`HeldOutReport::clip_accuracy`].
    pub accuracy: f64,
}

impl Aim {
    fn is_met(&self, report: &HeldOutReport) -> bool {
        f64::from(report.proven) >= self.proven && f64::from(report.clip_accuracy) >= self.accuracy
    }
}

/// Rungs, and when the next is climbed and the last left.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ladder {
    /// From the least to the most.
    pub rungs: Vec<Rung>,
    /// When the mark is good enough.
    pub aim: Aim,
    /// Steps from one look at the held-out clips to the next on the last rung, at least 1. On the others there is one, at the end:
    /// while the rates are high a mark is noise in good part, and reads worse than it will.
    pub every: usize,
    /// Looks in a row without progress after which the last rung has given what it can, at least 1.
    pub patience: u32,
    /// Held-out clips.
    pub held_out: u32,
}

impl Ladder {
    /// Whether a rung is the last, if there is such a rung at all.
    fn is_last(&self, rung: usize) -> bool {
        rung + 1 >= self.rungs.len()
    }

    /// Whether an embedding can climb it with `views` training clips.
    pub(super) fn is_sensible(&self, views: u32) -> bool {
        let grows = |pair: &[Rung]| {
            let [a, b] = pair else { return false };
            a.views <= b.views && a.reach <= b.reach && a.bases.count() <= b.bases.count()
        };
        let fits = |r: &Rung| r.reach > 0.0 && r.reach <= 1.0 && (1..=views).contains(&r.views) && r.steps > 0;
        let counts = self.every > 0 && self.patience > 0 && self.held_out > 0 && !self.rungs.is_empty();
        let Aim { p_value, proven, accuracy } = self.aim;
        let aims = [p_value, proven, accuracy].iter().all(|share| (0.0..=1.0).contains(share));
        counts && aims && self.rungs.iter().all(fits) && self.rungs.windows(2).all(grows)
    }
}

/// The figures of held-out clips after some step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Look {
    /// Steps taken.
    pub step: usize,
    /// See [`HeldOutReport::bit_accuracy`].
    pub bit_accuracy: f32,
    /// See [`HeldOutReport::clip_accuracy`].
    pub clip_accuracy: f32,
    /// See [`HeldOutReport::proven`].
    pub proven: f32,
    /// See [`HeldOutReport::psnr`].
    pub psnr: Decibels,
}

impl Look {
    pub(super) fn new(step: usize, report: &HeldOutReport) -> Self {
        let HeldOutReport { bit_accuracy, clip_accuracy, proven, psnr } = *report;
        Self { step, bit_accuracy, clip_accuracy, proven, psnr: Decibels(f64::from(psnr)) }
    }
}

/// Why a rung was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Left {
    /// Held-out clips showed what was asked for.
    Enough,
    /// They showed no progress any more.
    Flat,
    /// Its steps were used up.
    Steps,
}

/// What a rung bought. Its seconds are among those of the embedding.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RungReport {
    /// Splats that could get offsets.
    pub splats: usize,
    /// Offsets that were trained: floats.
    pub offsets: usize,
    /// Training clips.
    pub views: u32,
    /// Steps taken on it, those that settle the mark not counted.
    pub steps: usize,
    /// Why it was left.
    pub left: Left,
    /// The last look on it.
    pub look: Look,
}

/// What to do after a look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// More of the same.
    Stay,
    /// On to the next rung.
    Climb(Left),
    /// Settle, and end.
    End(Left),
}

/// Where an embedding stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Standing {
    /// Number of the rung.
    pub(super) rung: usize,
    /// Steps taken when it was reached.
    since: usize,
    /// Best share of bits so far.
    best: f32,
    /// Looks on this rung since there was progress.
    flat: u32,
    /// Steps taken when it was decided to end.
    decided_at: Option<usize>,
    /// All looks, also those of an embedding that takes all steps.
    pub(super) looks: Vec<Look>,
    /// The rungs that were left.
    pub(super) reports: Vec<RungReport>,
}

impl Standing {
    /// Takes in a look after `step` steps.
    pub(super) fn judge(&mut self, ladder: &Ladder, target_psnr: f32, step: usize, report: &HeldOutReport) -> Verdict {
        if self.decided_at.is_some() {
            return Verdict::Stay;
        }
        let is_met = ladder.aim.is_met(report) && report.psnr >= target_psnr - PSNR_SLACK_DB;
        let has_gained = report.bit_accuracy >= self.best + GAIN;
        if has_gained {
            (self.best, self.flat) = (report.bit_accuracy, 0);
        } else if report.psnr <= target_psnr + GROWN_DB {
            self.flat += 1;
        }
        let is_last = ladder.is_last(self.rung);
        let left = if is_met {
            Left::Enough
        } else if is_last && self.flat >= ladder.patience {
            Left::Flat
        } else if step >= self.end(ladder) {
            Left::Steps
        } else {
            return Verdict::Stay;
        };
        if left == Left::Enough || is_last {
            self.decided_at = Some(step);
            return Verdict::End(left);
        }
        Verdict::Climb(left)
    }

    /// Steps taken when the rung is left for want of more.
    fn end(&self, ladder: &Ladder) -> usize {
        self.since + ladder.rungs.get(self.rung).map_or(0, |rung| rung.steps)
    }

    /// Whether held-out clips are looked at after `step` steps.
    pub(super) fn is_look(&self, ladder: &Ladder, step: usize) -> bool {
        let on_the_way = ladder.is_last(self.rung) && (step - self.since).is_multiple_of(ladder.every);
        on_the_way || step == self.end(ladder)
    }

    /// Notes what the rung bought that is left after `step` steps.
    pub(super) fn leave(&mut self, step: usize, report: RungReport) {
        self.reports.push(RungReport { steps: step - self.since, ..report });
        // The mark settles from the rates that the last rung was left at.
        if self.decided_at.is_none() {
            (self.since, self.flat) = (step, 0);
        }
    }

    /// Whether the rung that it stands on is still to be reported.
    pub(super) fn is_under_way(&self) -> bool {
        self.reports.len() <= self.rung
    }

    /// Steps in all. Where the rates are at their floor already, nothing has to settle.
    pub(super) fn steps(&self, config: &EmbedConfig) -> usize {
        let settling = match &config.ladder {
            Some(ladder) if !ladder.is_last(self.rung) => 0,
            _ => SETTLING_STEPS,
        };
        self.decided_at.map_or(config.steps, |at| config.steps.min(at + settling))
    }

    /// Share of the learning rates in step number `step`: a cosine over each rung's steps, or over all without a ladder.
    pub(super) fn decay(&self, config: &EmbedConfig, step: usize) -> f32 {
        let end = config.ladder.as_ref().map_or(config.steps, |ladder| self.end(ladder).min(config.steps));
        let planned = |step: usize| cosine(step - self.since, end - self.since, config.lr_floor);
        match self.decided_at {
            None => planned(step),
            Some(at) => planned(at) * cosine(step - at, SETTLING_STEPS, config.lr_floor),
        }
    }
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
pub(super) fn name_of_bases<S: Serializer>(bases: &OffsetBases, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(match bases {
        OffsetBases::Dc => "dc",
        OffsetBases::All => "all",
    })
}

#[cfg(test)]
mod tests {
    use super::super::config::Profile;
    use super::*;
    use crate::watermark::evidence::ExtractorMode;

    fn ladder() -> Ladder {
        let dc = Rung { bases: OffsetBases::Dc, reach: 0.9, views: 2, steps: 100 };
        let rungs = vec![dc, Rung { reach: 1.0, views: 4, ..dc }];
        Ladder { rungs, aim: Aim { p_value: 1e-3, proven: 0.75, accuracy: 0.75 }, every: 10, patience: 2, held_out: 3 }
    }

    /// Its last rung alone.
    fn one_rung() -> Ladder {
        let ladder = ladder();
        Ladder { rungs: ladder.rungs[1..].to_vec(), ..ladder }
    }

    /// Verdicts on looks, and the steps after which they are taken; shares of bits right and of clips that prove it, PSNR. Climbs
    /// as told to.
    fn verdicts(ladder: &Ladder, looks: &[(f32, f32, f32)]) -> Vec<(usize, Verdict)> {
        let mut standing = Standing::default();
        let mut looks = looks.iter();
        let mut judge = |step: usize| {
            let &(bit_accuracy, proven, psnr) = standing.is_look(ladder, step).then(|| looks.next()).flatten()?;
            let report = HeldOutReport { bit_accuracy, clip_accuracy: bit_accuracy, proven, psnr };
            let verdict = standing.judge(ladder, 40.0, step, &report);
            if let Verdict::Climb(left) | Verdict::End(left) = verdict {
                let look = Look::new(step, &report);
                standing.leave(step, RungReport { splats: 1, offsets: 3, views: 2, steps: 0, left, look });
                standing.rung += usize::from(verdict == Verdict::Climb(left));
            }
            Some((step, verdict))
        };
        (1..=200).filter_map(&mut judge).collect()
    }

    #[test]
    fn a_look_ends_every_rung_and_the_last_one_has_some_on_the_way() {
        use Verdict::{Climb, End, Stay};
        let low = (0.6, 0.5, 40.4);
        let all = verdicts(&ladder(), &[low; 9]);
        // The look at the end of the first rung is the best so far.
        assert_eq!(all[..3], [(100, Climb(Left::Steps)), (110, Stay), (120, End(Left::Flat))], "{all:?}");
        let enough = verdicts(&ladder(), &[(0.9, 1.0, 40.4)]);
        assert_eq!(enough, [(100, End(Left::Enough))], "the first rung will do");
    }

    #[test]
    fn what_brings_no_progress_on_the_last_rung_ends_it() {
        use Verdict::{End, Stay};
        let low = |accuracy: f32| (accuracy, 0.5, 40.4);
        let flat = verdicts(&one_rung(), &[low(0.6), low(0.603), low(0.61), low(0.61), low(0.61), low(0.99)]);
        // 0.61 is progress by more than one standard error; what comes after the end decides nothing.
        let expected = [Stay, Stay, Stay, Stay, End(Left::Flat), Stay];
        assert_eq!(flat.iter().map(|(_, verdict)| *verdict).collect::<Vec<_>>(), expected, "{flat:?}");
        let rising: Vec<_> = (0..20).map(|i| low(0.5 + 0.02 * i as f32)).collect();
        let steps = verdicts(&one_rung(), &rising);
        assert_eq!(steps[9], (100, End(Left::Steps)), "{steps:?}");
        assert!(steps.iter().enumerate().all(|(i, (_, v))| *v == Stay || i == 9), "{steps:?}");
    }

    #[test]
    fn rates_go_down_once_on_every_rung_and_settle_from_where_the_last_was_left() {
        let config = EmbedConfig {
            steps: 150,
            ladder: Some(ladder()),
            ..EmbedConfig::new(Profile::Draft, ExtractorMode::Blind)
        };
        let mut standing = Standing::default();
        let decay = |standing: &Standing, step: usize| standing.decay(&config, step);
        assert_eq!(decay(&standing, 0), 1.0, "at first");
        let floor = config.lr_floor;
        assert!((decay(&standing, 100) - floor).abs() < 1e-6, "after the first rung: {}", decay(&standing, 100));
        (standing.rung, standing.since) = (1, 100);
        assert_eq!(decay(&standing, 100), 1.0, "at the start of the second");
        assert!((decay(&standing, 150) - floor).abs() < 1e-6, "steps end before the rung does");
        assert_eq!(standing.steps(&config), 150, "all");
        let before = decay(&standing, 120);
        standing.decided_at = Some(120);
        assert_eq!((decay(&standing, 120), standing.steps(&config)), (before, 120 + SETTLING_STEPS), "no jump");
        (standing.rung, standing.since, standing.decided_at) = (0, 0, Some(100));
        assert_eq!(standing.steps(&config), 100, "nothing has to settle");
    }

    #[test]
    fn a_look_at_which_enough_clips_prove_it_ends_it() {
        use Verdict::{End, Stay};
        let end = End(Left::Enough);
        let said = |looks: &[(f32, f32, f32)]| verdicts(&one_rung(), looks).iter().map(|(_, v)| *v).collect::<Vec<_>>();
        assert_eq!(said(&[(0.9, 0.74, 41.0), (0.9, 0.75, 41.0), (0.9, 1.0, 41.0)]), [Stay, end, Stay], "once");
        assert_eq!(said(&[(0.9, 1.0, 39.75)]), [end], "within the slack");
        assert_eq!(said(&[(0.75, 1.0, 44.0)]), [end], "the least share of bits");
        assert_eq!(said(&[(0.74, 1.0, 41.0); 3]), [Stay; 3], "too few bits");
        let flat = End(Left::Flat);
        assert_eq!(said(&[(0.9, 1.0, 39.0), (0.9, 1.0, 39.0), (0.9, 1.0, 39.0)]), [Stay, Stay, flat], "too loud");
        let faint = said(&[(0.6, 0.5, 45.0); 9]);
        assert_eq!(faint, [Stay; 9], "a mark that still grows is not done");
        let none = f32::NAN;
        assert_eq!(said(&[(none, none, none); 3]), [Stay; 3], "what is no number decides nothing");
    }

    #[test]
    fn each_rung_has_what_the_one_below_has() {
        let good = ladder();
        assert!(good.is_sensible(4), "as it is meant");
        assert!(!good.is_sensible(3), "more views than there are");
        let with = |change: &dyn Fn(&mut Ladder)| {
            let mut ladder = good.clone();
            change(&mut ladder);
            ladder.is_sensible(4)
        };
        let changes: [&dyn Fn(&mut Ladder); 12] = [
            &|l| l.rungs.clear(),
            &|l| l.rungs[1].reach = 0.5,
            &|l| l.rungs[1].views = 1,
            &|l| l.rungs[0].bases = OffsetBases::All,
            &|l| l.rungs[0].reach = f32::NAN,
            &|l| l.rungs[1].steps = 0,
            &|l| l.aim.p_value = f64::NAN,
            &|l| l.aim.accuracy = 1.5,
            &|l| l.aim.proven = -0.1,
            &|l| l.every = 0,
            &|l| l.patience = 0,
            &|l| l.held_out = 0,
        ];
        for (i, change) in changes.into_iter().enumerate() {
            assert!(!with(change), "change {i} makes no sense");
        }
    }
}
