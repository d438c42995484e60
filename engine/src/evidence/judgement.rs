//! From logits to a verdict: present, absent or inconclusive, with reasons.

use serde::Serialize;

use super::claim::Claim;
use super::extractor_mode::ExtractorMode;
use super::id_code::SearchedP;
use super::negative_controls::{Firing, NegativeControls, PanelLevels};
use super::reading::Spread;
use super::reason::Reason;
use super::statistics::{after_search, empirical_fpr_bound, match_p_value, required_matches};
use super::thresholds::{DecisionStatistic, Thresholds};
use crate::error::EngineError;

/// What the numbers allow to be said about chance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum PStatement {
    /// Message-blind extractor: exact p-values.
    Exact {
        /// Of the number of matches.
        matches: f64,
        /// Of the soft score.
        soft_score: f64,
    },
    /// Message-blind extractor, but not all that reads was fixed beforehand: what the p-value would be if it had been.
    NotCommitted(SearchedP),
    /// Message-blind extractor, and the best of several messages or rotations: bounds on the chance that any of them
    /// does so well.
    Searched(SearchedP),
    /// The extractor was trained with the message: only counted false positives on unrelated clips.
    Empirical {
        /// Unrelated clips that match as well as the suspect clip.
        false_positives: u32,
        /// Unrelated clips read.
        num_clips: u32,
        /// (1 + FP) / (1 + n), times the messages that the claim was chosen from; at most 1.
        bound: f64,
    },
}

/// The answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The clip holds the message.
    Present,
    /// The clip does not hold it, as far as this clip can tell.
    Absent,
    /// Neither can be said.
    Inconclusive,
}

impl Verdict {
    /// Exit code of `guard4d verify`.
    #[must_use]
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Present => 0,
            Self::Absent => 1,
            Self::Inconclusive => 4,
        }
    }
}

/// Everything a verification reports.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// The answer.
    pub verdict: Verdict,
    /// Why.
    pub reasons: Vec<Reason>,
    /// How the extractor came about.
    pub mode: ExtractorMode,
    /// Frames aggregated.
    pub num_frames: u32,
    /// Bits compared.
    pub num_bits: u32,
    /// Bits that match.
    pub matches: u32,
    /// Whether all bits of the message were read right.
    pub exact: bool,
    /// Matches needed for "present" by [`DecisionStatistic::Matches`]; none if impossible.
    pub matches_needed: Option<u32>,
    /// `matches / num_bits`.
    pub bit_accuracy: f64,
    /// Accuracy of single frames.
    pub frame_accuracy: Spread,
    /// Agreement of frames with one another.
    pub bit_consistency: f64,
    /// Logits signed by the message.
    pub margins: Spread,
    /// What can be said about chance.
    pub p_value: PStatement,
    /// Readings that must be at chance.
    pub panel: NegativeControls,
    /// The rule applied.
    pub thresholds: Thresholds,
}

/// Judges a claim by a rule fixed beforehand.
///
/// "Present" needs a p-value at most `fpr`, enough frames of enough size, no objection, and silent negative controls.
/// "Absent" needs frames that could have shown a mark and a p-value above `absent_above`. Everything else is
/// inconclusive, and so is whatever a `joint` extractor finds: films without a mark bound how often it says the
/// message by mistake, but who trained it could have trained it to say the message of one film alone.
///
/// # Errors
/// [`EngineError::Usage`] for inconsistent lengths or thresholds.
pub fn judge(claim: &Claim<'_>, thresholds: &Thresholds) -> Result<Evidence, EngineError> {
    thresholds.validate()?;
    if claim.searched == 0 {
        return Err(EngineError::Usage {
            what: "messages searched".to_owned(),
            got: "0".to_owned(),
            expected: "at least 1".to_owned(),
        });
    }
    let Claim { message, reading, .. } = claim;
    let num_bits = message.num_bits();
    let matches = reading.matches(message)?;
    let levels = PanelLevels { fpr: thresholds.fpr, control_level: thresholds.control_level };
    let panel = NegativeControls::run(claim, &levels)?;
    let p_value = state_p_value(claim, &panel)?;
    let (verdict, reasons) = decide(claim, thresholds, &p_value, &panel);
    let alone = thresholds.fpr / f64::from(thresholds.num_claims) / f64::from(claim.searched);
    Ok(Evidence {
        verdict,
        reasons,
        mode: claim.mode,
        num_frames: reading.num_frames(),
        num_bits,
        matches,
        exact: matches == num_bits,
        matches_needed: required_matches(num_bits, alone),
        bit_accuracy: f64::from(matches) / f64::from(num_bits),
        frame_accuracy: reading.frame_accuracy(message)?,
        bit_consistency: reading.bit_consistency(),
        margins: Spread::of(&reading.margins(message)?),
        p_value,
        panel,
        thresholds: *thresholds,
    })
}

fn state_p_value(claim: &Claim<'_>, panel: &NegativeControls) -> Result<PStatement, EngineError> {
    let searched = claim.searched;
    if claim.mode.is_message_blind() {
        let p = SearchedP::of(claim.reading, &claim.message, searched)?;
        let SearchedP { matches, soft_score, .. } = p;
        if claim.objections.iter().any(|objection| matches!(objection, Reason::NotCommitted { .. })) {
            return Ok(PStatement::NotCommitted(p));
        }
        return Ok(if searched == 1 { PStatement::Exact { matches, soft_score } } else { PStatement::Searched(p) });
    }
    let (num_clips, false_positives) = panel.unrelated_reaching(claim.reading.matches(&claim.message)?);
    let bound = after_search(empirical_fpr_bound(false_positives, num_clips), searched);
    Ok(PStatement::Empirical { false_positives, num_clips, bound })
}

fn decide(
    claim: &Claim<'_>,
    rule: &Thresholds,
    p_value: &PStatement,
    panel: &NegativeControls,
) -> (Verdict, Vec<Reason>) {
    let num_bits = claim.message.num_bits();
    let adjusted = |p: f64| (p * f64::from(rule.num_claims)).min(1.0);
    let (p, best) = match *p_value {
        PStatement::Exact { matches, soft_score }
        | PStatement::NotCommitted(SearchedP { matches, soft_score, .. })
        | PStatement::Searched(SearchedP { matches, soft_score, .. }) => {
            let p = match rule.statistic {
                DecisionStatistic::Matches => matches,
                DecisionStatistic::SoftScore => soft_score,
            };
            (p, match_p_value(num_bits, num_bits))
        }
        PStatement::Empirical { bound, num_clips, .. } => (bound, empirical_fpr_bound(0, num_clips)),
    };
    let (p, best) = (adjusted(p), adjusted(after_search(best, claim.searched)));
    let fpr = rule.fpr;
    let mut reasons = insufficient(claim, rule);
    let could_show = reasons.is_empty() && best <= rule.absent_above;
    reasons.extend(claim.objections.iter().cloned());
    reasons
        .extend(panel.firing().into_iter().map(|Firing { what, name }| Reason::ControlFires { control: what, name }));
    let verdict = if p <= fpr {
        let proves = reasons.is_empty() && claim.mode.is_message_blind();
        let verdict = if proves { Verdict::Present } else { Verdict::Inconclusive };
        reasons.insert(0, Reason::Passes { p_value: p, fpr });
        verdict
    } else if could_show && p > rule.absent_above {
        let absent_above = rule.absent_above;
        reasons.insert(0, Reason::AtChance { p_value: p, absent_above });
        Verdict::Absent
    } else {
        reasons.insert(0, Reason::Weak { p_value: p, fpr });
        Verdict::Inconclusive
    };
    if best > fpr {
        reasons.push(Reason::CannotReach { best_p_value: best, fpr });
    }
    if let PStatement::Empirical { num_clips, .. } = *p_value {
        reasons.push(Reason::EmpiricalOnly { num_clips });
    }
    (verdict, reasons)
}

fn insufficient(claim: &Claim<'_>, rule: &Thresholds) -> Vec<Reason> {
    let mut reasons = Vec::new();
    let got = claim.reading.num_frames();
    if got < rule.min_frames {
        reasons.push(Reason::TooFewFrames { got, needed: rule.min_frames });
    }
    if claim.side_px < rule.min_side_px {
        reasons.push(Reason::FramesTooSmall { got_px: claim.side_px, needed_px: rule.min_side_px });
    }
    reasons
}
