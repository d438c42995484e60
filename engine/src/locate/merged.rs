//! Fewer splats for small pictures: those that are near each other are drawn as one, which has their mean and
//! covariance (as the nodes of a hierarchy have, Kerbl et al. 2024).

use std::collections::HashMap;

use nalgebra::{Matrix3, Vector3};

use crate::base::numbers::narrow;
use crate::scene::Gaussians;
use crate::scene::ellipsoid::{covariance, of_covariance};
use crate::scene::gaussians::{SH_FLOATS, opacity_of};

/// The most that one splat covers: as opaque as renderers draw any.
const MOST_OPAQUE: f64 = 0.99;

/// Splats with those as one that are in one cube of this side, world units, and no larger than it; in the order of the
/// first of each.
#[must_use]
pub fn merged(splats: &Gaussians, side: f64) -> Gaussians {
    let mut number_of = HashMap::new();
    let mut sums: Vec<Sum> = Vec::new();
    for row in 0..splats.len() {
        let new = sums.len();
        let number = cube(splats, row, side).map_or(new, |cube| *number_of.entry(cube).or_insert(new));
        if number == new {
            sums.push(Sum::of(row));
        }
        sums[number].add(splats, row);
    }
    let mut all = Gaussians { sh_degree: splats.sh_degree, ..Gaussians::default() };
    for sum in sums {
        sum.put(splats, &mut all);
    }
    all
}

/// In which cube a splat is; none of a splat that is larger.
fn cube(splats: &Gaussians, row: usize, side: f64) -> Option<[i32; 3]> {
    let deviation = splats.scales[row].into_iter().fold(f32::NEG_INFINITY, f32::max);
    #[allow(clippy::cast_possible_truncation, reason = "all that is beyond is in the last cube")]
    let place = |at: f32| (f64::from(at) / side).floor() as i32;
    (2.0 * f64::from(deviation).exp() <= side).then(|| splats.means[row].map(place))
}

/// What splats are together, each as much as it covers.
#[derive(Clone)]
struct Sum {
    /// The first of them, and how many there are.
    row: usize,
    count: usize,
    covered: f64,
    mean: Vector3<f64>,
    /// Of places, about the origin.
    square: Matrix3<f64>,
    sh_coeffs: [f64; SH_FLOATS],
}

impl Sum {
    /// Of those that begin with this one, before any is added.
    fn of(row: usize) -> Self {
        Self {
            row,
            count: 0,
            covered: 0.0,
            mean: Vector3::zeros(),
            square: Matrix3::zeros(),
            sh_coeffs: [0.0; SH_FLOATS],
        }
    }

    fn add(&mut self, splats: &Gaussians, row: usize) {
        self.count += 1;
        let covered = opacity_of(splats.opacities[row]) * area(splats.scales[row]);
        let mean = Vector3::from(splats.means[row].map(f64::from));
        let own = covariance(splats.scales[row], splats.quats[row]);
        self.covered += covered;
        self.mean += covered * mean;
        self.square += covered * (own + mean * mean.transpose());
        let own = &splats.sh_coeffs[SH_FLOATS * row..SH_FLOATS * (row + 1)];
        self.sh_coeffs.iter_mut().zip(own).for_each(|(sum, own)| *sum += covered * f64::from(*own));
    }

    fn put(self, splats: &Gaussians, all: &mut Gaussians) {
        let Self { row, count, covered, .. } = self;
        if count == 1 || covered <= 0.0 {
            all.means.push(splats.means[row]);
            all.quats.push(splats.quats[row]);
            all.scales.push(splats.scales[row]);
            all.opacities.push(splats.opacities[row]);
            all.sh_coeffs.extend_from_slice(&splats.sh_coeffs[SH_FLOATS * row..SH_FLOATS * (row + 1)]);
            return;
        }
        let mean = self.mean / covered;
        let (scales, quat) = of_covariance(self.square / covered - mean * mean.transpose());
        let opacity = (covered / area(scales)).min(MOST_OPAQUE);
        all.means.push([mean.x, mean.y, mean.z].map(narrow));
        all.quats.push(quat);
        all.scales.push(scales);
        all.opacities.push(narrow((opacity / (1.0 - opacity)).ln()));
        all.sh_coeffs.extend(self.sh_coeffs.map(|sum| narrow(sum / covered)));
    }
}

/// How much a splat of these log standard deviations covers, seen from all sides alike, in units that all share: the
/// mean of what it covers along its axes.
fn area(scales: [f32; 3]) -> f64 {
    let [x, y, z] = scales.map(|scale| f64::from(scale).exp());
    (x * y + y * z + x * z) / 3.0
}
