//! Random splats before a camera, on the host, on the device and projected by the twin.

use guard4d_kernels::reference::Real;
use guard4d_kernels::reference::splat::project::{self as twin, Projected};
use guard4d_kernels::reference::splat::rules::Rules as TwinRules;
use guard4d_kernels::reference::splat::traverse::Screen;
use guard4d_kernels::splat::project::{RawSplats, View};
use guard4d_kernels::splat::rules::{Extent, Opacity, Rules, SortKey, Stop};
use guard4d_kernels::{Buffer, Device};

use crate::support::random::Random;

/// Means with opacity logits, log scales, quaternions, each `[N,4]`.
pub(crate) struct Scene {
    pub(crate) means: Vec<f32>,
    pub(crate) scales: Vec<f32>,
    pub(crate) quats: Vec<f32>,
}

/// A camera at (0, 0, -3) that looks along z, slightly turned.
pub(crate) fn view(width: u32, height: u32) -> View {
    let (sin, cos) = 0.1f32.sin_cos();
    View {
        world_to_camera: [[cos, 0.0, sin, 0.05], [0.0, 1.0, 0.0, -0.1], [-sin, 0.0, cos, 3.0]],
        focal: [1.1 * width as f32, 1.2 * width as f32],
        centre: [0.5 * width as f32 - 0.5, 0.5 * height as f32 - 0.5],
        width,
        height,
        rules: Rules::REFERENCE,
    }
}

/// `n` splats in the unit cube, of a few pixels each in an image of 40 px or more.
pub(crate) fn random(n: usize, seed: u64) -> Scene {
    let mut random = Random(seed);
    let mut scene = Scene { means: Vec::new(), scales: Vec::new(), quats: Vec::new() };
    for _ in 0..n {
        let opacity = random.uniform(-3.0, 4.0);
        scene.means.extend(random.vec_f32(3, -1.0, 1.0));
        scene.means.push(opacity as f32);
        scene.scales.extend(random.vec_f32(3, -4.5, -2.0));
        scene.scales.push(0.0);
        scene.quats.extend(random.vec_f32(4, -1.0, 1.0));
    }
    scene
}

/// Rules that are nobody's, so that each number is another than the reference's somewhere and falls to many splats.
pub(crate) fn rules() -> [Rules; 4] {
    let wide = Rules { dilation: 1.2, opacity: Opacity::Compensated, max_alpha: 0.7, ..Rules::REFERENCE };
    let quads = Rules {
        extent: Extent::Image,
        margin: f32::INFINITY,
        reach: 2.5,
        min_alpha: 0.002,
        max_alpha: 1.0,
        stop: Stop::Behind,
        sort_key: SortKey::Distance,
        ..Rules::REFERENCE
    };
    let bent = Rules { dilation: 0.05, foot: 0.05, min_minor: 0.8, min_major: 1.5, guard: 0.9, ..quads };
    let split = Rules { min_split: 2.0, margin: 0.4, sort_key: SortKey::Depth, ..quads };
    [wide, quads, bent, split]
}

/// What the twin draws a view on, and how.
pub(crate) fn screen<R: Real>(view: &View) -> Screen<R> {
    let of = |v: f32| R::of(f64::from(v));
    let finite = |v: f32| v.is_finite().then(|| of(v));
    let rules = view.rules;
    let rules = TwinRules {
        dilation: of(rules.dilation),
        compensated: rules.opacity == Opacity::Compensated,
        min_split: of(rules.min_split),
        min_minor: of(rules.min_minor),
        min_major: of(rules.min_major),
        margin: finite(rules.margin),
        guard: finite(rules.guard),
        in_tiles: rules.extent == Extent::Tiles,
        reach: finite(rules.reach),
        foot: of(rules.foot),
        min_alpha: of(rules.min_alpha),
        max_alpha: of(rules.max_alpha),
        ends_behind: rules.stop == Stop::Behind,
        by_distance: rules.sort_key == SortKey::Distance,
    };
    Screen { size: [view.width as usize, view.height as usize], rules }
}

/// A [`Scene`] on the device.
pub(crate) struct Uploaded {
    means: Buffer<f32>,
    scales: Buffer<f32>,
    quats: Buffer<f32>,
}

impl Uploaded {
    pub(crate) fn raw(&self) -> RawSplats<'_> {
        RawSplats { means: &self.means, scales: &self.scales, quats: &self.quats, buckets: None }
    }
}

impl Scene {
    pub(crate) fn len(&self) -> usize {
        self.means.len() / 4
    }

    pub(crate) fn upload(&self, device: &Device) -> Uploaded {
        let buffer = |name: &str, data: &[f32]| device.buffer_from(name, data).expect("buffer");
        Uploaded {
            means: buffer("means", &self.means),
            scales: buffer("scales", &self.scales),
            quats: buffer("quats", &self.quats),
        }
    }

    /// The twin's projection.
    pub(crate) fn project<R: Real>(&self, view: &View) -> Vec<Option<Projected<R>>> {
        let convert = |data: &[f32]| data.iter().map(|v| R::of(f64::from(*v))).collect::<Vec<_>>();
        let of = |v: f32| R::of(f64::from(v));
        let view = twin::View {
            world_to_camera: view.world_to_camera.map(|row| row.map(of)),
            focal: view.focal.map(of),
            centre: view.centre.map(of),
            size: [view.width as usize, view.height as usize],
            rules: screen(view).rules,
        };
        twin::forward(&view, &convert(&self.means), &convert(&self.scales), &convert(&self.quats))
    }
}
