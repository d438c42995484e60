//! How renderers keep splats: what is rounded or left out before anything is drawn.

use glam::{Quat, Vec3};
use half::f16;

use crate::base::numbers::narrow;
use crate::scene::gaussians::{CHANNELS, Gaussians, MAX_SH_DEGREE, SH_FLOATS, Y0, dc_of_colour, sh_bases};

/// Natural logarithms of the standard deviations between which viewers' logarithmic steps lie.
const LOG_SCALES: [f32; 2] = [-12.0, 9.0];
/// Logits of an opacity that single precision cannot tell from 0 and 1.
const LARGEST_LOGIT: f32 = 100.0;

/// Equal steps between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Steps {
    /// None: numbers stay as they are, below 0 and above 1 too.
    Exact,
    /// So many; the nearest is taken.
    Nearest(f32),
    /// So many; the next below is taken.
    Below(f32),
}

/// How rotations are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rotations {
    /// As they are.
    Exact,
    /// Axis on an octahedron in 8 and 8 bits, angle in 8.
    AxisAngle,
    /// `xyz / sqrt(1 + w)` in 11, 11 and 10 bits.
    Folded,
    /// Components in 8 bits, with a sign.
    Bytes,
}

/// How positions are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Positions {
    /// As they are.
    Exact,
    /// In 16-bit floats.
    Half,
}

/// How a renderer keeps splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Storage {
    /// Highest degree of the spherical harmonics that it draws, from 0 to 3.
    pub sh_degree: u32,
    /// Steps between -1 and 0, and between 0 and 1, for the coefficients of each degree from 1 on; beyond ±1 they are
    /// cut.
    pub sh_steps: Option<[f32; MAX_SH_DEGREE as usize]>,
    /// Of base colours.
    pub colours: Steps,
    /// Of opacities.
    pub opacities: Steps,
    /// Equal steps of the standard deviations' logarithms from -12 to 9.
    pub scale_steps: Option<f32>,
    /// Of rotations.
    pub rotations: Rotations,
    /// Of positions.
    pub positions: Positions,
}

impl Storage {
    /// Everything as the file says it.
    pub const EXACT: Self = Self {
        sh_degree: MAX_SH_DEGREE,
        sh_steps: None,
        colours: Steps::Exact,
        opacities: Steps::Exact,
        scale_steps: None,
        rotations: Rotations::Exact,
        positions: Positions::Exact,
    };

    /// The splats that it makes of `gaussians`.
    #[must_use]
    pub fn kept(&self, gaussians: &Gaussians) -> Gaussians {
        let mut kept = gaussians.clone();
        kept.sh_degree = kept.sh_degree.min(self.sh_degree);
        let above = sh_bases(kept.sh_degree) * CHANNELS;
        for splat in kept.sh_coeffs.chunks_exact_mut(SH_FLOATS) {
            splat[above..].fill(0.0);
            splat[..CHANNELS].iter_mut().for_each(|dc| *dc = self.colours.of_dc(*dc));
            self.round_sh(splat);
        }
        kept.opacities.iter_mut().for_each(|logit| *logit = self.opacities.of_logit(*logit));
        if let Some(steps) = self.scale_steps {
            kept.scales.as_flattened_mut().iter_mut().for_each(|log| *log = on_logarithmic_steps(*log, steps));
        }
        kept.quats.iter_mut().for_each(|quat| *quat = self.rotations.of(*quat));
        if self.positions == Positions::Half {
            kept.means.as_flattened_mut().iter_mut().for_each(|x| *x = f16::from_f32(*x).to_f32());
        }
        kept
    }

    fn round_sh(&self, splat: &mut [f32]) {
        let Some(steps) = self.sh_steps else { return };
        for (degree, steps) in (1..).zip(steps) {
            let values = &mut splat[sh_bases(degree - 1) * CHANNELS..sh_bases(degree) * CHANNELS];
            values.iter_mut().for_each(|value| *value = (value.clamp(-1.0, 1.0) * steps).round() / steps);
        }
    }
}

impl Steps {
    /// A number from 0 to 1.
    fn of(self, value: f32) -> f32 {
        match self {
            Self::Exact => value,
            Self::Nearest(steps) => (value.clamp(0.0, 1.0) * steps).round() / steps,
            Self::Below(steps) => (value.clamp(0.0, 1.0) * steps).floor() / steps,
        }
    }

    fn of_dc(self, dc: f32) -> f32 {
        if self == Self::Exact { dc } else { dc_of_colour(self.of(narrow(0.5 + f64::from(dc) * Y0))) }
    }

    fn of_logit(self, logit: f32) -> f32 {
        if self == Self::Exact {
            return logit;
        }
        let opacity = self.of(1.0 / (1.0 + (-logit).exp()));
        (opacity / (1.0 - opacity)).ln().clamp(-LARGEST_LOGIT, LARGEST_LOGIT)
    }
}

/// A standard deviation's logarithm on one of `steps` equal steps.
fn on_logarithmic_steps(log: f32, steps: f32) -> f32 {
    let [low, high] = LOG_SCALES;
    let step = (high - low) / steps;
    low + ((log - low) / step).round().clamp(0.0, steps) * step
}

impl Rotations {
    /// A quaternion w, x, y, z; one of no length stays.
    fn of(self, quat: [f32; 4]) -> [f32; 4] {
        let [w, x, y, z] = quat;
        let turn = Quat::from_xyzw(x, y, z, w);
        if self == Self::Exact || !turn.is_finite() || turn.length_squared() == 0.0 {
            return quat;
        }
        let unit = turn.normalize();
        let turn = match self {
            Self::Exact => unit,
            Self::AxisAngle => axis_angle(if unit.w < 0.0 { -unit } else { unit }),
            Self::Folded => folded(if unit.w < 0.0 { -unit } else { unit }),
            Self::Bytes => {
                let byte = |v: f32| ((v * 128.0 + 128.0).clamp(0.0, 255.0).round() - 128.0) / 128.0;
                Quat::from_xyzw(byte(unit.x), byte(unit.y), byte(unit.z), byte(unit.w))
            }
        };
        [turn.w, turn.x, turn.y, turn.z]
    }
}

/// The nearest of `steps` equal steps from 0 to 1.
fn nearest(value: f32, steps: f32) -> f32 {
    (value.clamp(0.0, 1.0) * steps).round() / steps
}

/// A unit quaternion of w >= 0 with 8 bits for its angle and for both coordinates of its axis, which is projected onto
/// an octahedron and unfolded (Meyer et al. 2010).
fn axis_angle(unit: Quat) -> Quat {
    const STEPS: f32 = 255.0;
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    let half = unit.w.min(1.0).acos();
    let along = Vec3::new(unit.x, unit.y, unit.z);
    let axis = if half.sin().abs() < 1e-6 { Vec3::X } else { along / half.sin() };
    let folded = axis / axis.abs().element_sum();
    let (mut u, mut v) = (folded.x, folded.y);
    if axis.z < 0.0 {
        (u, v) = ((1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v));
    }
    let (u, v) = (2.0 * nearest(0.5 * u + 0.5, STEPS) - 1.0, 2.0 * nearest(0.5 * v + 0.5, STEPS) - 1.0);
    let below = (u.abs() + v.abs() - 1.0).max(0.0);
    let axis = Vec3::new(u - sign(u) * below, v - sign(v) * below, 1.0 - u.abs() - v.abs()).normalize_or(Vec3::X);
    let half = nearest(half / std::f32::consts::FRAC_PI_2, STEPS) * std::f32::consts::FRAC_PI_2;
    Quat::from_xyzw(axis.x * half.sin(), axis.y * half.sin(), axis.z * half.sin(), half.cos())
}

/// A unit quaternion of w >= 0 by its vector part over `sqrt(1 + w)`, which fills a ball.
fn folded(unit: Quat) -> Quat {
    const FINE: f32 = 2047.0;
    const COARSE: f32 = 1023.0;
    let flat = Vec3::new(unit.x, unit.y, unit.z) / (1.0 + unit.w).sqrt();
    let on_steps = |v: f32, steps: f32| 2.0 * nearest(0.5 * v + 0.5, steps) - 1.0;
    let flat = Vec3::new(on_steps(flat.x, FINE), on_steps(flat.y, FINE), on_steps(flat.z, COARSE));
    let squared = flat.length_squared();
    let vector = flat * (2.0 - squared).max(0.0).sqrt();
    Quat::from_xyzw(vector.x, vector.y, vector.z, 1.0 - squared)
}
