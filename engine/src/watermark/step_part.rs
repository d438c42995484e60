//! Where the device time of training goes.

use std::collections::BTreeMap;

use guard4d_kernels::{Recorder, Timings};
use serde::Serialize;

/// Parts of a training step, in its order. Passes are recorded in the part that they are for, see
/// `StepPart::record`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StepPart {
    /// Colours and splatting.
    RenderForward,
    /// Back to the offsets.
    RenderBackward,
    /// Clamp, resize, noise and normalisation, both ways.
    Image,
    /// R, both ways.
    Tmsd,
    /// CLIP's image tower and the decoder, both ways.
    Clip,
    /// Fidelity, message and control losses; LPIPS with its network.
    Losses,
    /// Adam.
    Optimiser,
    /// What the host reads, brought together.
    Copies,
    /// What no part was named for.
    Other,
}

impl StepPart {
    /// All parts, in the order of a step.
    pub const ALL: [Self; 9] = [
        Self::RenderForward,
        Self::RenderBackward,
        Self::Image,
        Self::Tmsd,
        Self::Clip,
        Self::Losses,
        Self::Optimiser,
        Self::Copies,
        Self::Other,
    ];

    /// Name for tables, and for [`Recorder::part`].
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::RenderForward => "render",
            Self::RenderBackward => "render_backward",
            Self::Image => "image",
            Self::Tmsd => "tmsd",
            Self::Clip => "clip",
            Self::Losses => "losses",
            Self::Optimiser => "optimiser",
            Self::Copies => "copies",
            Self::Other => "other",
        }
    }

    /// Records passes as this part.
    pub(in crate::watermark) fn record<R>(self, rec: &mut Recorder, passes: impl FnOnce(&mut Recorder) -> R) -> R {
        rec.part(self.name(), passes)
    }

    /// The part that a pass was recorded in.
    fn of(name: Option<&str>) -> Self {
        Self::ALL.into_iter().find(|part| Some(part.name()) == name).unwrap_or(Self::Other)
    }
}

/// Device seconds of steps, by kernel and by part.
#[derive(Clone, Debug, Default)]
pub(in crate::watermark) struct StepSeconds {
    pub(in crate::watermark) kernels: BTreeMap<&'static str, f64>,
    parts: BTreeMap<StepPart, f64>,
}

impl StepSeconds {
    /// Adds what a step took.
    pub(in crate::watermark) fn add(&mut self, timings: &Timings) {
        for pass in &timings.passes {
            let seconds = pass.time.as_secs_f64();
            *self.kernels.entry(pass.name).or_default() += seconds;
            *self.parts.entry(StepPart::of(pass.part)).or_default() += seconds;
        }
    }

    /// By part; those that took none are 0.
    pub(in crate::watermark) fn parts(&self) -> BTreeMap<StepPart, f64> {
        let mut parts: BTreeMap<_, _> = StepPart::ALL.into_iter().map(|part| (part, 0.0)).collect();
        parts.extend(&self.parts);
        parts
    }
}
