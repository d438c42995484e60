//! Other people's renderers: what they do with the same splats, as numbers.
//!
//! Each preset says where its numbers come from; `tests/interop/viewers.cjs` films by the viewers themselves. What is
//! not modelled are the rounded positions by which `GaussianSplats3D` sorts.

use std::str::FromStr;

use guard4d_kernels::Device;
use guard4d_kernels::splat::rules::{Extent, Framebuffer, Opacity, Rules, SortKey, Stop};
use serde::{Deserialize, Serialize};

use super::deform::DeformField;
use super::storage::{Positions, Rotations, Steps, Storage};
use crate::error::EngineError;
use crate::scene::{Gaussians, Motion};

/// Square root of 8: standard deviations to which viewers draw their quads.
const QUAD: f32 = 2.0 * std::f32::consts::SQRT_2;
/// What 8 bits hold.
const BYTE: f32 = 255.0;

/// How a renderer shows splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    /// From splats to pixels.
    pub rules: Rules,
    /// From the file to splats.
    pub storage: Storage,
}

/// Renderers with a preset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
pub enum Viewer {
    /// The rasteriser of Kerbl et al. 2023.
    Reference,
    /// gsplat, `rasterize_mode="classic"`.
    Gsplat,
    /// gsplat, `rasterize_mode="antialiased"`.
    GsplatAntialiased,
    /// Spark on three.js.
    Spark,
    /// The `PlayCanvas` engine.
    PlayCanvas,
    /// `GaussianSplats3D` on three.js.
    GaussianSplats3d,
    /// `SuperSplat`'s editor.
    SuperSplat,
    /// antimatter15/splat.
    Antimatter15,
}

/// What viewers that draw a quad for each splat have in common.
const QUADS: Rules = Rules {
    margin: f32::INFINITY,
    extent: Extent::Image,
    reach: QUAD,
    max_colour: 1.0,
    // What changes a channel by less than half a step of 8 bits is lost in their framebuffers.
    min_alpha: 0.5 / BYTE,
    max_alpha: 1.0,
    stop: Stop::Behind,
    framebuffer: Framebuffer::Bytes,
    ..Rules::REFERENCE
};

impl Profile {
    /// The reference, which everything is drawn by unless something else is asked for.
    pub const REFERENCE: Self = Self { rules: Rules::REFERENCE, storage: Storage::EXACT };

    /// Uploads a scene as the renderer keeps it, to be drawn by [`Profile::rules`].
    ///
    /// # Errors
    /// When device memory runs out.
    pub fn upload(&self, device: &Device, gaussians: &Gaussians, motion: &Motion) -> Result<DeformField, EngineError> {
        if self.storage == Storage::EXACT {
            return DeformField::new(device, gaussians, motion);
        }
        let kept = self.storage.kept(gaussians);
        match motion {
            Motion::Sequence(moments) => {
                let moments = moments.iter().map(|moment| self.storage.kept(moment)).collect();
                DeformField::new(device, &kept, &Motion::Sequence(moments))
            }
            // Sorts begin before anything is rounded.
            Motion::Still if self.rules.sort_key == SortKey::Buckets => {
                DeformField::new(device, &kept, motion)?.with_buckets_of(gaussians)
            }
            _ => DeformField::new(device, &kept, motion),
        }
    }
}

impl Viewer {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Reference,
        Self::Gsplat,
        Self::GsplatAntialiased,
        Self::Spark,
        Self::PlayCanvas,
        Self::GaussianSplats3d,
        Self::SuperSplat,
        Self::Antimatter15,
    ];

    /// As the command line calls it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Gsplat => "gsplat",
            Self::GsplatAntialiased => "gsplat-antialiased",
            Self::Spark => "spark",
            Self::PlayCanvas => "playcanvas",
            Self::GaussianSplats3d => "gaussian-splats-3d",
            Self::SuperSplat => "supersplat",
            Self::Antimatter15 => "antimatter15",
        }
    }

    /// What it does at its own settings.
    #[must_use]
    pub fn profile(self) -> Profile {
        match self {
            Self::Reference => Profile::REFERENCE,
            Self::Gsplat => Profile { rules: gsplat(Opacity::Kept), storage: Storage::EXACT },
            Self::GsplatAntialiased => Profile { rules: gsplat(Opacity::Compensated), storage: Storage::EXACT },
            Self::Spark => spark(),
            Self::PlayCanvas => play_canvas(),
            Self::GaussianSplats3d => gaussian_splats_3d(),
            Self::SuperSplat => super_splat(),
            Self::Antimatter15 => antimatter15(),
        }
    }
}

impl FromStr for Viewer {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|viewer| viewer.name() == text);
        found.ok_or_else(|| format!("one of {} is expected", Self::ALL.map(Self::name).join(", ")))
    }
}

impl From<Viewer> for &'static str {
    fn from(viewer: Viewer) -> Self {
        viewer.name()
    }
}

impl TryFrom<String> for Viewer {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// gsplat 1.5: `gsplat/cuda/csrc/ProjectionEWA3DGSFused.cu` bounds splats by their opacity, not by three standard
/// deviations, and `RasterizeToPixels3DGSFwd.cu` lets alpha reach 0.999.
fn gsplat(opacity: Opacity) -> Rules {
    Rules { opacity, extent: Extent::Image, reach: 3.33, max_alpha: 0.999, ..Rules::REFERENCE }
}

/// `@sparkjsdev/spark` 2.2.0, `dist/spark.module.js`: `splatVertex` and `splatFragment` for the rules, `setPackedSplat`
/// and `encodeSh1Rgb` for the storage. Opacities are halved before they are put into 8 bits.
fn spark() -> Profile {
    let rules = Rules { opacity: Opacity::Compensated, guard: 1.4, sort_key: SortKey::Distance, ..QUADS };
    let storage = Storage {
        sh_steps: Some([63.0, 127.0, 31.0]),
        colours: Steps::Nearest(BYTE),
        opacities: Steps::Nearest(0.5 * BYTE),
        scale_steps: Some(254.0),
        rotations: Rotations::AxisAngle,
        positions: Positions::Half,
        ..Storage::EXACT
    };
    Profile { rules, storage }
}

/// `playcanvas` 2.23.3, `build/playcanvas/src/scene/shader-lib/glsl/chunks/gsplat`: `vert/gsplatCorner.js` measures in
/// half pixels, so that its variances are four times ours; `frag/gsplat.js` bends the falloff, and
/// `frag/formats/containerCompactWrite.js` says what the work buffer keeps. `scene/gsplat-unified` sorts by buckets.
fn play_canvas() -> Profile {
    let rules = Rules {
        dilation: 0.3 / 4.0,
        min_minor: 0.1 / 4.0,
        // Quads of fewer than two half pixels from the middle to the edge are left out.
        min_major: 1.0 / (QUAD * QUAD),
        foot: (-4.0f32).exp(),
        max_colour: f32::INFINITY,
        min_alpha: 1.0 / BYTE,
        sort_key: SortKey::Buckets,
        ..QUADS
    };
    let storage = Storage {
        opacities: Steps::Nearest(BYTE),
        scale_steps: Some(255.0),
        rotations: Rotations::Folded,
        ..Storage::EXACT
    };
    Profile { rules, storage }
}

/// `@mkkellogg/gaussian-splats-3d` 0.4.7, `build/gaussian-splats-3d.module.js`: `SplatMaterial3D` for the rules,
/// `INRIAV1PlyParser` for the storage. It draws no spherical harmonics unless it is asked to.
fn gaussian_splats_3d() -> Profile {
    let rules = Rules { min_split: 0.1f32.sqrt(), guard: 1.2, ..QUADS };
    let storage =
        Storage { sh_degree: 0, colours: Steps::Below(BYTE), opacities: Steps::Below(BYTE), ..Storage::EXACT };
    Profile { rules, storage }
}

/// playcanvas/supersplat at 01e2fdd, `src/shaders/splat-shader.ts`: the corners of `PlayCanvas` with a plain falloff.
fn super_splat() -> Profile {
    // Its target holds half floats.
    let framebuffer = Framebuffer::Floats;
    let sort_key = SortKey::Depth;
    let rules = Rules { foot: 0.0, min_alpha: QUADS.min_alpha, sort_key, framebuffer, ..play_canvas().rules };
    Profile { rules, storage: Storage::EXACT }
}

/// antimatter15/splat at 027a182, `main.js`: no dilation at all.
fn antimatter15() -> Profile {
    let storage = Storage {
        sh_degree: 0,
        colours: Steps::Nearest(BYTE),
        opacities: Steps::Nearest(BYTE),
        rotations: Rotations::Bytes,
        ..Storage::EXACT
    };
    // Its framebuffer has 8 bits, too, but is filled front to back.
    let rules = Rules { dilation: 0.0, guard: 1.2, framebuffer: Framebuffer::Floats, ..QUADS };
    Profile { rules, storage }
}
