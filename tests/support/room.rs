//! A room: a scene that nobody sees from outside, with cameras that stand in it.

use glam::{DMat3, DMat4, DVec3};
use guard4d_engine::scene::gaussians::{SH_FLOATS, Y0};
use guard4d_engine::scene::{Camera, FrameSize, Gaussians};

use super::random::Random;

/// Half of its sides, m; z is up, and its middle is the origin.
const HALF: [f64; 3] = [2.5, 2.0, 1.3];
/// From one splat to the next on a wall, m.
const APART: f64 = 0.09;
/// Pictures on each wall.
const PICTURES: usize = 7;

/// Walls, floor and ceiling with pictures on them, and two cupboards.
pub(crate) fn room() -> Gaussians {
    let mut random = Random(77);
    let mut all = Gaussians::default();
    let boxes = [
        (DVec3::ZERO, DVec3::from(HALF)),
        (DVec3::new(1.6, 1.4, -0.7), DVec3::new(0.5, 0.35, 0.6)),
        (DVec3::new(-1.9, -0.9, -0.9), DVec3::new(0.35, 0.6, 0.4)),
    ];
    for (middle, half) in boxes {
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                wall(&mut all, &mut random, Wall { middle, half, axis, side });
            }
        }
    }
    all
}

#[derive(Clone, Copy)]
struct Wall {
    middle: DVec3,
    half: DVec3,
    axis: usize,
    side: f64,
}

fn wall(all: &mut Gaussians, random: &mut Random, Wall { middle, half, axis, side }: Wall) {
    let [across, along] = [(axis + 1) % 3, (axis + 2) % 3];
    let mut of = |low: f64, high: f64, count: usize| random.vec(count, low, high);
    let ground = of(0.1, 0.9, 3);
    // Of a colour, at a place, so large.
    let pictures: Vec<_> = (0..PICTURES).map(|_| [of(0.1, 0.9, 3), of(-1.0, 1.0, 2), of(0.08, 0.3, 2)]).collect();
    let steps = |axis: usize| (2.0 * half[axis] / APART).ceil() as usize;
    for i in 0..=steps(across) {
        for j in 0..=steps(along) {
            let [u, v] = [(i, across), (j, along)].map(|(at, axis)| 2.0 * at as f64 / steps(axis) as f64 - 1.0);
            let is_there =
                |place: &[f64], half: &[f64]| (u - place[0]).abs() < half[0] && (v - place[1]).abs() < half[1];
            let shown = pictures.iter().find(|[_, place, half]| is_there(place, half));
            let colour = shown.map_or(&ground, |[colour, ..]| colour);
            let mut mean = middle;
            mean[axis] += side * half[axis];
            mean[across] += u * half[across];
            mean[along] += v * half[along];
            let mut scales = [(0.6 * APART).ln() as f32; 3];
            scales[axis] = 0.01f32.ln();
            let mut coeffs = [0.0f32; SH_FLOATS];
            for (dc, colour) in coeffs.iter_mut().zip(colour) {
                *dc = ((colour - 0.5) / Y0) as f32;
            }
            all.means.push(mean.as_vec3().to_array());
            all.quats.push([1.0, 0.0, 0.0, 0.0]);
            all.scales.push(scales);
            all.opacities.push(4.0);
            all.sh_coeffs.extend(coeffs);
        }
    }
}

/// A camera in it, at eye level: where it stands, which way it looks, from x toward y and up, degrees, and its lens.
#[derive(Clone, Copy)]
pub(crate) struct Standing {
    pub(crate) place: [f64; 2],
    pub(crate) looks_deg: [f64; 2],
    pub(crate) fov_deg: f64,
}

impl Standing {
    pub(crate) fn camera(self, size: FrameSize) -> Camera {
        let Self { place: [x, y], looks_deg, fov_deg } = self;
        let [azimuth, rise] = looks_deg.map(f64::to_radians);
        let forward = DVec3::new(rise.cos() * azimuth.cos(), rise.cos() * azimuth.sin(), rise.sin());
        let right = forward.cross(DVec3::Z).normalize();
        let to_camera = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let place = DVec3::new(x, y, 0.2);
        let world_to_camera = DMat4::from_mat3_translation(to_camera, -(to_camera * place)).as_mat4();
        Camera::with_fov(world_to_camera, fov_deg.to_radians(), size)
    }
}

/// Cameras of the capture: some places, from each of which one looks another way.
pub(crate) fn capture() -> Vec<Standing> {
    let places = [[-1.2, -0.6], [-0.2, -0.9], [0.9, -0.8], [1.1, 0.3], [0.1, 0.6], [-1.0, 0.7]];
    let looks =
        |(number, place): (usize, [f64; 2])| Standing { place, looks_deg: [130.0 * number as f64, 0.0], fov_deg: 60.0 };
    places.into_iter().enumerate().map(looks).collect()
}
