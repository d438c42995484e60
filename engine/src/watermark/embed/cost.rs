//! Where the device time of training goes.

use std::collections::BTreeMap;

use serde::Serialize;

use super::{Embedded, Embedding};

/// Parts of a training step, in its order.
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
    /// CLIP's image tower and the decoder, both ways. They share their kernels; the decoder's share is tiny.
    Clip,
    /// Fidelity, message and control losses; LPIPS with its network.
    Losses,
    /// Adam.
    Optimiser,
    /// Copies and fills between the others.
    Copies,
    /// Kernels that no training step uses.
    Other,
}

/// Beginnings of pass names; the first that fits counts.
const TABLE: [(&str, StepPart); 20] = [
    ("splat/dc_colour_fwd", StepPart::RenderForward),
    ("splat/sh_fwd", StepPart::RenderForward),
    ("splat/rasterize_clear", StepPart::RenderForward),
    ("splat/rasterize_fwd", StepPart::RenderForward),
    ("splat/rasterize_bwd", StepPart::RenderBackward),
    ("splat/rasterize_gather", StepPart::RenderBackward),
    ("splat/dc_colour_bwd", StepPart::RenderBackward),
    ("splat/sh_bwd", StepPart::RenderBackward),
    ("image/colour_map", StepPart::Tmsd),
    ("image/crop", StepPart::Losses),
    ("image/", StepPart::Image),
    ("nn/conv3d", StepPart::Tmsd),
    ("nn/axpy", StepPart::Tmsd),
    ("nn/matmul_fwd_windows", StepPart::Losses),
    ("nn/max_pool", StepPart::Losses),
    ("nn/", StepPart::Clip),
    ("loss/", StepPart::Losses),
    ("optim/", StepPart::Optimiser),
    ("copy", StepPart::Copies),
    ("fill", StepPart::Copies),
];

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

    /// The part that a pass belongs to, by its name in [`guard4d_kernels::Timings`].
    #[must_use]
    pub fn of(pass: &str) -> Self {
        TABLE.iter().find(|(start, _)| pass.starts_with(start)).map_or(Self::Other, |(_, part)| *part)
    }

    /// Name for tables.
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
}

fn parts(device_seconds: &BTreeMap<&'static str, f64>) -> BTreeMap<StepPart, f64> {
    let mut parts: BTreeMap<_, _> = StepPart::ALL.into_iter().map(|part| (part, 0.0)).collect();
    for (pass, seconds) in device_seconds {
        *parts.entry(StepPart::of(pass)).or_default() += seconds;
    }
    parts
}

impl Embedding<'_> {
    /// Device seconds of the steps so far by part; parts that took none are 0.
    #[must_use]
    pub fn part_seconds(&self) -> BTreeMap<StepPart, f64> {
        parts(&self.device_seconds)
    }
}

impl Embedded {
    /// Device seconds of training by part; parts that took none are 0.
    #[must_use]
    pub fn part_seconds(&self) -> BTreeMap<StepPart, f64> {
        parts(&self.device_seconds)
    }
}
