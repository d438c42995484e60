//! What leaks: a copy, several that were mixed, or a copy that somebody worked on.

use guard4d_engine::base::numbers::narrow;
use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose, standard_normal, uniform_below, uniform_unit};
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::scene::Gaussians;
use guard4d_engine::scene::gaussians::{CHANNELS, SH_FLOATS, Y0};

/// The first copy that leaks; mixtures take those behind it.
pub const LEAKED: u64 = 70_123;
/// Opacity, a logit, of splats that were removed: films do not show them, and their motion needs no other numbers.
const REMOVED: f32 = -30.0;
/// Of all that is drawn here.
const SEED: [u8; 32] = [99; 32];

/// How several copies become one: by a rule for each splat's base colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Their mean.
    Average,
    /// One of them, drawn anew for each splat.
    Splice,
    /// The middle one.
    Median,
    /// The least.
    Min,
    /// The largest.
    Max,
    /// Between the least and the largest.
    Midpoint,
    /// What fewer of them have.
    Minority,
    /// As far beyond what fewer of them have as that is from their mean.
    Overshoot,
}

/// All rules with their names.
pub const RULES: [(&str, Rule); 8] = [
    ("average", Rule::Average),
    ("splice", Rule::Splice),
    ("median", Rule::Median),
    ("min", Rule::Min),
    ("max", Rule::Max),
    ("midpoint", Rule::Midpoint),
    ("minority", Rule::Minority),
    ("overshoot", Rule::Overshoot),
];

/// What leaks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leak {
    /// The original.
    Original,
    /// A copy as it was given.
    Copy,
    /// So many copies, mixed.
    Mixed(Rule, usize),
    /// A copy without this share of its splats.
    Pruned(f64),
    /// A copy with noise of this deviation on its base colours, of 1.
    Noise(f64),
    /// A copy without what turns with the view.
    Flat,
    /// A copy that was stamped once more, by somebody else.
    StampedAgain,
    /// A copy as `.splat` keeps it: colours, opacities and turns of 8 bits, and nothing that turns with the view.
    EightBits,
    /// Somebody else's copy of the same original.
    Foreign,
}

impl Leak {
    /// The copies that contributed.
    #[must_use]
    pub fn copies(self) -> Vec<u64> {
        match self {
            Self::Original | Self::Foreign => Vec::new(),
            Self::Mixed(_, count) => (LEAKED..).take(count).collect(),
            _ => vec![LEAKED],
        }
    }

    /// The splats that leak.
    #[must_use]
    pub fn gaussians(self, issue: &Issue<'_>) -> Gaussians {
        let mut gaussians = issue.model().gaussians.clone();
        let mut rng = Prf::new(&MasterSecret::from_bytes(SEED)).stream(Purpose::ControlNoise, 0);
        let stranger = || Issue::new(issue.model(), Prf::new(&MasterSecret::from_bytes([98; 32])), issue.strength());
        gaussians.sh_coeffs = match self {
            Self::Original => gaussians.sh_coeffs,
            Self::Foreign => stranger().stamp(LEAKED),
            Self::Mixed(rule, count) => mixed(issue, rule, count),
            _ => issue.stamp(LEAKED),
        };
        match self {
            Self::Pruned(share) => {
                let removed = gaussians.opacities.iter_mut().filter(|_| uniform_unit(&mut rng) < share);
                removed.for_each(|opacity| *opacity = REMOVED);
            }
            Self::Noise(deviation) => {
                for row in gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS) {
                    let noise = |dc: &mut f32| *dc += narrow(deviation / Y0 * standard_normal(&mut rng));
                    row[..CHANNELS].iter_mut().for_each(noise);
                }
            }
            Self::Flat => {
                gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS).for_each(|row| row[CHANNELS..].fill(0.0));
            }
            Self::EightBits => to_eight_bits(&mut gaussians),
            Self::StampedAgain => {
                let (before, after) = (&issue.model().gaussians.sh_coeffs, stranger().stamp(LEAKED));
                let moves = before.iter().zip(after);
                gaussians.sh_coeffs.iter_mut().zip(moves).for_each(|(dc, (before, after))| *dc += after - before);
            }
            _ => {}
        }
        gaussians
    }
}

/// As `.splat` files round (antimatter15); opacities are logits here, and colours SH coefficients.
fn to_eight_bits(gaussians: &mut Gaussians) {
    let level = |value: f64| (value.clamp(0.0, 1.0) * 255.0).round() / 255.0;
    for row in gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS) {
        row[..CHANNELS].iter_mut().for_each(|dc| *dc = narrow((level(0.5 + Y0 * f64::from(*dc)) - 0.5) / Y0));
        row[CHANNELS..].fill(0.0);
    }
    for logit in &mut gaussians.opacities {
        // What is wholly opaque has no finite logit.
        let opacity = level(1.0 / (1.0 + (-f64::from(*logit)).exp())).clamp(1e-4, 1.0 - 1e-4);
        *logit = narrow((opacity / (1.0 - opacity)).ln());
    }
    for turn in &mut gaussians.quats {
        let length = turn.iter().map(|part| part * part).sum::<f32>().sqrt();
        turn.iter_mut().for_each(|part| *part = ((*part / length * 128.0).round().clamp(-128.0, 127.0)) / 128.0);
    }
}

/// The splats that are left.
#[must_use]
pub fn without_removed(gaussians: &Gaussians) -> Gaussians {
    let mut left = gaussians.clone();
    left.retain(&gaussians.opacities.iter().map(|opacity| *opacity > REMOVED).collect::<Vec<_>>());
    left
}

/// Base colours by a rule over copies.
fn mixed(issue: &Issue<'_>, rule: Rule, count: usize) -> Vec<f32> {
    let mut rng = Prf::new(&MasterSecret::from_bytes(SEED)).stream(Purpose::ControlNoise, 1);
    let copies: Vec<Vec<f32>> = (LEAKED..).take(count).map(|copy| issue.stamp(copy)).collect();
    let mut out = copies[0].clone();
    for (row, start) in out.chunks_exact_mut(SH_FLOATS).zip((0..).step_by(SH_FLOATS)) {
        let one = uniform_below(&mut rng, u32::try_from(count).unwrap_or(u32::MAX)) as usize;
        for (channel, dc) in row[..CHANNELS].iter_mut().enumerate() {
            let mut values: Vec<f32> = copies.iter().map(|copy| copy[start + channel]).collect();
            let drawn = values[one.min(count - 1)];
            values.sort_by(f32::total_cmp);
            *dc = by_rule(rule, &values, drawn);
        }
    }
    out
}

/// One value of several, smallest first.
fn by_rule(rule: Rule, values: &[f32], drawn: f32) -> f32 {
    let (least, most) = (values[0], values[values.len() - 1]);
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    // Where fewer copies are is the end that is farther from the mean.
    let minority = if most - mean > mean - least { most } else { least };
    match rule {
        Rule::Average => mean,
        Rule::Splice => drawn,
        Rule::Median => values[values.len() / 2],
        Rule::Min => least,
        Rule::Max => most,
        Rule::Midpoint => f32::midpoint(least, most),
        Rule::Minority => minority,
        Rule::Overshoot => 2.0 * minority - mean,
    }
}
