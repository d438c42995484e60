//! Whose copy is it: what films show, against every copy of an issue, with a verdict.

use guard4d_kernels::Device;
use serde::Serialize;

use super::gathered::{DrawnAs, Gathered, SharedClaim};
use crate::error::EngineError;
use crate::fingerprint::issue::Issue;
use crate::fingerprint::power::unspoilt_score;
use crate::fingerprint::trace::{Decoys, Scored, Scorer};
use crate::locate::finding::LocateReport;
use crate::release::ledger::Ledger;

/// A family of false accusations in so many is borne unless something else is asked.
pub const DEFAULT_FPR: f64 = 1e-6;
/// Copies that were never made, scored for comparison.
const DECOYS: u64 = 10_000;
/// What is left of a mark in the worst film that a copy is still asked to be found in, as a share of the score.
const LEAST_GAIN: f64 = 0.08;
/// Standard deviations by which such a film would have to be over the threshold, before silence is taken for an answer.
const MARGIN: f64 = 3.0;

/// What the answer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Tracing {
    /// At least one copy contributed.
    Traced,
    /// No copy of this issue: one would have been found.
    None,
    /// Too little is seen to say either.
    Inconclusive,
}

impl Tracing {
    /// Process exit code.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Traced => 0,
            Self::None => 1,
            Self::Inconclusive => 4,
        }
    }
}

/// A copy that is named.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Named {
    /// Who got it; none where the ledger does not say.
    pub recipient: Option<String>,
    /// Its number.
    pub copy: u64,
    /// Bound on the probability that any copy scores so high by chance.
    pub p_family: f64,
    /// Decimal logarithm of it, which does not become 0.
    pub log10_p_family: f64,
    /// The same by the saddle point, which proves nothing.
    pub log10_p_estimate: f64,
    /// Standard deviations above chance.
    pub score: f64,
}

/// The answer, and what it rests on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The answer.
    pub verdict: Tracing,
    /// Who is named, best first.
    pub copies: Vec<Named>,
    /// Whether it is of this issue at all.
    pub owner: SharedClaim,
    /// Copies that were looked at, which the p-values are multiplied by.
    pub copies_scored: u64,
    /// Readings that were tried, which they are multiplied by too.
    pub hypotheses: u64,
    /// Frames that were read; none of an asset.
    pub frames: u64,
    /// Largest p-value that names a copy.
    pub fpr: f64,
    /// The best score of all copies, named or not.
    pub best_score: f64,
    /// The score that names a copy; none where no score could.
    pub required_score: Option<f64>,
    /// Where nobody is named: what a copy would have scored at the mean in the worst film that is still asked of.
    pub least_expected_score: Option<f64>,
    /// What copies score that were never made.
    pub decoys: Decoys,
    /// How each film was drawn, as far as that shows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub drawn_as: Vec<DrawnAs>,
    /// How the cameras of films were found that nobody gave.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub located: Vec<LocateReport>,
}

/// What is asked.
#[derive(Debug)]
pub struct TraceRequest<'a> {
    /// Device.
    pub device: &'a Device,
    /// The issue, of the ledger's terms and the original.
    pub issue: &'a Issue<'a>,
    /// Who got what.
    pub ledger: &'a Ledger,
    /// Copies to score, from number 1 on; at least those of the ledger.
    pub copies: u64,
    /// Largest p-value that names a copy.
    pub fpr: f64,
}

/// Scores every copy, and says who is named.
///
/// # Errors
/// Those of scoring, and of the ledger.
pub fn judge(request: &TraceRequest<'_>, gathered: &mut Gathered) -> Result<Report, EngineError> {
    let TraceRequest { device, issue, ledger, fpr, .. } = *request;
    let evidence = &gathered.chips;
    let scorer = Scorer::new(device, issue, evidence)?;
    let copies_scored = request.copies.max(ledger.last_number()?).max(1);
    let best = scorer.best(1..copies_scored + 1)?;
    let log_fpr = fpr.ln();
    let named = best.iter().filter(|scored| scored.log_p_family <= log_fpr);
    let copies = named.map(|scored| name(ledger, scored)).collect::<Result<Vec<_>, _>>()?;
    let required = scorer.required_score(log_fpr - (copies_scored as f64).ln());
    let mut least_expected = None;
    if copies.is_empty() {
        let unspoilt = f64::from(gathered.parts) * unspoilt_score(issue, &mut *gathered.last, gathered.noise)?;
        least_expected = Some(scorer.in_deviations(LEAST_GAIN * unspoilt));
    }
    let is_power_enough = required.zip(least_expected).is_some_and(|(required, t)| t >= required + MARGIN);
    let owner = gathered.shared(issue)?;
    let is_of_issue = owner.log10_p <= fpr.log10();
    Ok(Report {
        verdict: match (copies.is_empty(), is_power_enough && !is_of_issue) {
            (false, _) => Tracing::Traced,
            (true, true) => Tracing::None,
            (true, false) => Tracing::Inconclusive,
        },
        copies,
        owner,
        copies_scored,
        hypotheses: 1,
        frames: gathered.frames,
        fpr,
        best_score: best.first().map_or(0.0, |scored| scored.score),
        required_score: required,
        least_expected_score: least_expected,
        decoys: scorer.decoys(DECOYS)?,
        drawn_as: gathered.looks.clone(),
        located: gathered.located.clone(),
    })
}

fn name(ledger: &Ledger, scored: &Scored) -> Result<Named, EngineError> {
    let [log10_p_family, log10_p_estimate] =
        [scored.log_p_family, scored.log_p_estimate].map(|log_p| log_p / std::f64::consts::LN_10);
    Ok(Named {
        recipient: ledger.of_number(scored.copy)?.map(|record| record.recipient),
        copy: scored.copy,
        p_family: scored.log_p_family.exp(),
        log10_p_family,
        log10_p_estimate,
        score: scored.score,
    })
}
