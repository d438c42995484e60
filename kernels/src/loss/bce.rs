//! Objectives on message logits: BCE, margin, and the control losses.

use crate::error::KernelError;
use crate::registry::loss::{bce_bwd, bce_fwd};
use crate::shape::dim;
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "loss/bce";
/// Lavapipe 22.3 ends every loop of an invocation after 65,535 iterations.
const MAX_GROUP: usize = 65_535;

/// What the logits of a group should do. B is the group's mean BCE against the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Objective {
    /// B itself (Guard4D Eq. 9).
    Bce,
    /// Mean softplus(margin − s·o), s = ±1 from the target: goes on where BCE saturates.
    Margin {
        /// Logit beyond which a bit is left alone.
        margin: f32,
    },
    /// 1 / (B + ε), the paper's control loss (Guard4D Eq. 10). It has no minimum.
    InverseBce {
        /// ε
        eps: f32,
    },
    /// 1 / (min(B, ln 2) + ε): the same, but it stops at chance.
    Hinge {
        /// ε
        eps: f32,
    },
    /// Mean o²: pulls controls to no opinion.
    Chance,
}

impl Objective {
    /// Code of `glsl/lib/bce.glsl`, margin and ε.
    fn codes(self) -> (u32, f32, f32) {
        match self {
            Self::Bce => (0, 0.0, 0.0),
            Self::Margin { margin } => (1, margin, 0.0),
            Self::InverseBce { eps } => (2, 0.0, eps),
            Self::Hinge { eps } => (3, 0.0, eps),
            Self::Chance => (4, 0.0, 0.0),
        }
    }

    /// The loss that belongs to a group's value as [`forward`] gives it.
    #[must_use]
    pub fn loss(self, value: f32) -> f32 {
        match self {
            Self::Bce | Self::Margin { .. } | Self::Chance => value,
            Self::InverseBce { eps } => 1.0 / (value + eps),
            // `min` would drop a NaN.
            Self::Hinge { eps } if value > std::f32::consts::LN_2 => 1.0 / (std::f32::consts::LN_2 + eps),
            Self::Hinge { eps } => 1.0 / (value + eps),
        }
    }
}

/// Logits of `groups × rows × bits`; a group is what one value is taken over.
#[derive(Clone, Copy, Debug)]
pub struct Groups {
    /// Groups, such as the clips of a batch.
    pub groups: usize,
    /// Rows of a group, such as the frames of a clip.
    pub rows: usize,
    /// Message bits.
    pub bits: usize,
}

/// What the logits of all groups say, and what they should say.
#[derive(Clone, Copy, Debug)]
pub struct Answers<'a> {
    /// How the logits are grouped.
    pub groups: Groups,
    /// `[G,R,L]`
    pub logits: &'a Buffer<f32>,
    /// `[L]`, or `[G,R,L]` where every row has its own; 0 or 1.
    pub target: &'a Buffer<f32>,
}

impl Groups {
    fn per_group(self) -> usize {
        self.rows * self.bits
    }
}

impl Answers<'_> {
    /// Checks the buffers; returns the target's stride: 0 when every row has the same target.
    fn check(&self, value: &Buffer<f32>) -> Result<u32, KernelError> {
        let Self { groups, logits, target } = self;
        let total = groups.groups * groups.per_group();
        let shape = |buffer, got: usize, expected: String| {
            Err(KernelError::Shape { kernel: KERNEL, buffer, got: format!("[{got}]"), expected })
        };
        if groups.per_group() == 0 || groups.per_group() > MAX_GROUP {
            return shape("group", groups.per_group(), format!("1 to {MAX_GROUP} logits"));
        }
        if logits.len() != total {
            return shape("logits", logits.len(), format!("[{total}]"));
        }
        if value.len() != groups.groups {
            return shape("value", value.len(), format!("[{}]", groups.groups));
        }
        match target.len() {
            n if n == groups.bits => Ok(0),
            n if n == total => Ok(1),
            n => shape("target", n, format!("[{}] or [{total}]", groups.bits)),
        }
    }
}

/// The value of each group: B, the mean margin loss, or the mean square.
///
/// # Shapes
/// in `logits` \[G,R,L\] · `target` \[L\] or \[G,R,L\], 0 or 1 · out `value` \[G\] (=)
/// # Equation: Guard4D Eq. 9; [`Objective`]
/// # Determinism: bitwise; each group is one sum in order
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    objective: Objective,
    answers: &Answers<'_>,
    value: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let target_stride = answers.check(value)?;
    let Answers { groups, logits, target } = *answers;
    let (code, margin, _) = objective.codes();
    let params = bce_fwd::Params {
        groups: dim(groups.groups),
        per_group: dim(groups.per_group()),
        bits: dim(groups.bits),
        target_stride,
        margin,
    };
    let bind = bce_fwd::Bind { logits, target, value };
    rec.dispatch_spec(bind, params, bce_fwd::Spec { objective: code }, Grid::threads(groups.groups))
}

/// Gradient of `weight · Σ_groups loss(value)` to the logits.
///
/// # Shapes
/// in `logits` \[G,R,L\] · `target` \[L\] or \[G,R,L\] · `value` \[G\] of [`forward`] · out `v_logits` \[G,R,L\] (=)
/// # Equation: Guard4D Eq. 9 and 10; [`Objective`]
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    objective: Objective,
    weight: f32,
    answers: &Answers<'_>,
    value: &Buffer<f32>,
    v_logits: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let target_stride = answers.check(value)?;
    Answers { logits: v_logits, ..*answers }.check(value)?;
    let Answers { groups, logits, target } = *answers;
    let (code, margin, eps) = objective.codes();
    let params = bce_bwd::Params {
        n: dim(logits.len()),
        per_group: dim(groups.per_group()),
        bits: dim(groups.bits),
        target_stride,
        margin,
        eps,
        weight,
    };
    let bind = bce_bwd::Bind { logits, target, value, v_logits };
    rec.dispatch_spec(bind, params, bce_bwd::Spec { objective: code }, Grid::threads(logits.len()))
}
