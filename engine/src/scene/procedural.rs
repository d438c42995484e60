//! Textured scenes made of nothing but random numbers, for training on scenes that nobody owns.
//!
//! Solids stand about the origin, as D-NeRF scenes do, before a plain background or within a hall. What they are
//! painted with ranges from one colour to waves, stripes and specks at every scale, so that no two scenes have the same
//! content.

use std::f64::consts::TAU;
use std::ops::Range;
use std::path::Path;

use glam::{DQuat, DVec3};
use rand_chacha::ChaCha20Rng;

use super::gaussians::{CHANNELS, Gaussians, SH_FLOATS, Y0};
use super::model::Model;
use crate::base::numbers::narrow;
use crate::base::prf::{standard_normal, uniform_below, uniform_unit};
use crate::error::EngineError;

/// What a scene is written as, should anybody write it.
const NAME: &str = "procedural.ply";
/// Splats of all solids together: as many as small captures have.
const SPLATS: Range<f64> = 6000.0..14000.0;
/// Solids.
const SOLIDS: (u32, u32) = (3, 9);
/// How far the middles of the solids lie from the origin at most; cameras at 4 units see 1.4 to either side.
const SPREAD: f64 = 0.8;
/// Half of the side of a hall.
const HALL: f64 = 2.2;
/// Waves of a texture.
const WAVES: (u32, u32) = (1, 6);
/// Their heights in brightness.
const WAVE_HEIGHTS: Range<f64> = 0.02..0.2;
/// Deviation of the SH coefficients above DC, in brightness.
const SHINE: f64 = 0.05;

/// A static scene of SH degree 1; the same stream gives the same scene.
///
/// # Errors
/// Those of [`Model::of_splats`]; not with the streams of this program.
pub fn scene(rng: &mut ChaCha20Rng) -> Result<Model, EngineError> {
    let total = between(rng, SPLATS);
    let solids = SOLIDS.0 + uniform_below(rng, SOLIDS.1 - SOLIDS.0 + 1);
    let palette = Palette::draw(rng);
    let mut gaussians = Gaussians { sh_degree: 1, ..Gaussians::default() };
    let has_hall = uniform_below(rng, 3) == 0;
    let share = total / f64::from(solids + if has_hall { 2 } else { 0 });
    for _ in 0..solids {
        let solid = Solid::draw(&palette, rng);
        solid.add(share, &mut gaussians, &palette, rng);
    }
    if has_hall {
        let walls = Solid {
            shape: Shape::Box,
            middle: DVec3::new(0.0, 0.0, HALL - SPREAD),
            half: DVec3::splat(HALL),
            turn: DQuat::IDENTITY,
            opacity: 4.0,
            paint: Paint::draw(&palette, rng),
        };
        walls.add(2.0 * share, &mut gaussians, &palette, rng);
    }
    let background = match uniform_below(rng, 3) {
        0 => [0.0; CHANNELS],
        1 => [1.0; CHANNELS],
        _ => {
            let brightness = uniform_unit(rng);
            palette.colour(brightness, rng).to_array().map(|value| narrow(value.clamp(0.0, 1.0)))
        }
    };
    Model::of_splats(Path::new(NAME), &gaussians, background)
}

/// Surfaces that splats are scattered on.
#[derive(Clone, Copy)]
enum Shape {
    Ellipsoid,
    Box,
    /// A box's upper face.
    Sheet,
    /// Anywhere inside.
    Cloud,
}

struct Solid {
    shape: Shape,
    middle: DVec3,
    half: DVec3,
    turn: DQuat,
    /// Logit.
    opacity: f64,
    paint: Paint,
}

impl Solid {
    fn draw(palette: &Palette, rng: &mut ChaCha20Rng) -> Self {
        let shape = [Shape::Ellipsoid, Shape::Box, Shape::Sheet, Shape::Cloud][uniform_below(rng, 4) as usize];
        let mut three = |low: f64, high: f64| DVec3::from_array(std::array::from_fn(|_| between(rng, low..high)));
        let (middle, half) = (three(-SPREAD, SPREAD), three(0.12, 0.75));
        let axis = three(-1.0, 1.0).normalize_or(DVec3::Z);
        Self {
            shape,
            middle,
            half,
            turn: DQuat::from_axis_angle(axis, between(rng, 0.0..TAU)),
            opacity: between(rng, 0.0..5.0),
            paint: Paint::draw(palette, rng),
        }
    }

    /// A point in the unit cube's measure, and the direction that the surface faces there.
    fn point(&self, rng: &mut ChaCha20Rng) -> (DVec3, DVec3) {
        let mut cube = || DVec3::from_array(std::array::from_fn(|_| between(rng, -1.0..1.0)));
        match self.shape {
            Shape::Ellipsoid => {
                let facing = cube().normalize_or(DVec3::Z);
                (facing, facing)
            }
            Shape::Cloud => (cube(), cube().normalize_or(DVec3::Z)),
            Shape::Sheet => (cube().with_z(1.0), DVec3::Z),
            Shape::Box => {
                let (mut at, face) = (cube(), uniform_below(rng, 6) as usize);
                let side = if face < 3 { 1.0 } else { -1.0 };
                at[face % 3] = side;
                (at, DVec3::AXES[face % 3] * side)
            }
        }
    }

    /// Adds about `count` splats, which lie flat on the surface and touch each other.
    fn add(&self, count: f64, gaussians: &mut Gaussians, palette: &Palette, rng: &mut ChaCha20Rng) {
        let DVec3 { x, y, z } = self.half;
        let spacing = (4.0 * (x * y + y * z + z * x) / count).sqrt();
        let flat = (spacing * between(rng, 0.4..0.9), spacing * 0.1);
        let mut left = count;
        while left >= 1.0 {
            left -= 1.0;
            let (at, facing) = self.point(rng);
            let turn = self.turn * DQuat::from_rotation_arc(DVec3::Z, facing);
            let local = at * self.half;
            let mean = self.middle + self.turn * local;
            gaussians.means.push(mean.to_array().map(narrow));
            gaussians.quats.push([turn.w, turn.x, turn.y, turn.z].map(narrow));
            let stretch = (0.3 * standard_normal(rng)).exp();
            gaussians.scales.push([flat.0 * stretch, flat.0 / stretch, flat.1].map(|scale| narrow(scale.ln())));
            gaussians.opacities.push(narrow(self.opacity + standard_normal(rng)));
            let mut coeffs = [0.0; SH_FLOATS];
            let dc = self.paint.at(local, rng).map(|colour| (colour - 0.5) / Y0);
            coeffs[..CHANNELS].copy_from_slice(&dc.map(narrow));
            for basis in 1..4 {
                let shine = palette.difference(SHINE, rng).to_array().map(narrow);
                coeffs[basis * CHANNELS..][..CHANNELS].copy_from_slice(&shine);
            }
            gaussians.sh_coeffs.extend(coeffs);
        }
    }
}

/// The colours of a scene: greys, one hue and its opposite, and very little of what lies across both.
///
/// Captures are like that: of the mean squares of the colours of robot, fox and fruit along their three main axes, the
/// least is that of a deviation of 0.0008 to 0.005, across grey, and nearer to green and magenta than to any other hue;
/// the next one's is 0.02 to 0.12.
struct Palette {
    hue: DVec3,
    across: DVec3,
    tint: f64,
    rest: f64,
}

impl Palette {
    fn draw(rng: &mut ChaCha20Rng) -> Self {
        let green = DVec3::new(-1.0, 2.0, -1.0).normalize();
        let grey = DVec3::ONE.normalize();
        let turn = match uniform_below(rng, 4) {
            0 => between(rng, 0.0..TAU),
            _ => 0.4 * standard_normal(rng),
        };
        let across = DQuat::from_axis_angle(grey, turn) * green;
        let tint = between(rng, 0.02f64.ln()..0.15f64.ln()).exp();
        Self { hue: grey.cross(across), across, tint, rest: between(rng, 0.0005f64.ln()..0.02f64.ln()).exp() }
    }

    /// A grey of this brightness, tinted at random.
    fn colour(&self, brightness: f64, rng: &mut ChaCha20Rng) -> DVec3 {
        let (tint, rest) = (self.tint * standard_normal(rng), self.rest * standard_normal(rng));
        DVec3::splat(brightness) + self.hue * tint + self.across * rest
    }

    /// A small difference between colours, mostly of brightness.
    fn difference(&self, size: f64, rng: &mut ChaCha20Rng) -> DVec3 {
        let brightness = size * standard_normal(rng);
        let (tint, rest) = (self.tint * standard_normal(rng), self.rest * standard_normal(rng));
        let share = (size / WAVE_HEIGHTS.end).min(1.0);
        DVec3::splat(brightness) + share * (self.hue * tint + self.across * rest)
    }
}

/// A solid texture: a colour, waves about it, and specks.
struct Paint {
    base: DVec3,
    waves: Vec<Wave>,
    specks: f64,
}

struct Wave {
    frequency: DVec3,
    phase: f64,
    colour: DVec3,
    is_stripe: bool,
}

impl Paint {
    fn draw(palette: &Palette, rng: &mut ChaCha20Rng) -> Self {
        let brightness = between(rng, 0.1..0.9);
        let base = palette.colour(brightness, rng);
        let waves = (0..WAVES.0 + uniform_below(rng, WAVES.1 - WAVES.0 + 1)).map(|_| {
            let direction = DVec3::from_array(std::array::from_fn(|_| standard_normal(rng))).normalize_or(DVec3::X);
            // Wavelengths from twice a solid's size to that of its splats.
            let frequency = direction * (between(rng, 0.0..4.0).exp() * 2.0);
            let height = between(rng, WAVE_HEIGHTS);
            let colour = palette.difference(height, rng);
            Wave { frequency, phase: between(rng, 0.0..TAU), colour, is_stripe: uniform_below(rng, 3) == 0 }
        });
        Self { base, waves: waves.collect(), specks: between(rng, 0.0..0.06) }
    }

    fn at(&self, local: DVec3, rng: &mut ChaCha20Rng) -> [f64; CHANNELS] {
        let wave = |wave: &Wave| {
            let value = (wave.frequency.dot(local) + wave.phase).cos();
            wave.colour * if wave.is_stripe { value.signum() } else { value }
        };
        let speck = self.specks * standard_normal(rng);
        let colour = self.base + self.waves.iter().map(wave).sum::<DVec3>() + speck;
        colour.to_array().map(|value| value.clamp(0.0, 1.0))
    }
}

/// A number from `range`, uniformly.
fn between(rng: &mut ChaCha20Rng, range: Range<f64>) -> f64 {
    range.start + (range.end - range.start) * uniform_unit(rng)
}
