//! Twin of `splat/project_fwd`.

use super::deform::normalize;
use super::rules::Rules;
use crate::reference::real::Real;

/// A pinhole camera, `OpenCV` axes.
#[derive(Clone, Copy, Debug)]
pub struct View<R> {
    /// World to camera without its last row, row-major.
    pub world_to_camera: [[R; 4]; 3],
    /// Focal lengths in px.
    pub focal: [R; 2],
    /// Principal point in px, pixel centres at whole numbers.
    pub centre: [R; 2],
    /// Image width and height in px.
    pub size: [usize; 2],
    /// How splats are drawn.
    pub rules: Rules<R>,
}

/// A splat that the view may see.
#[derive(Clone, Copy, Debug)]
pub struct Projected<R> {
    /// Centre in px, pixel centres at integers.
    pub mean2d: [R; 2],
    /// Inverse covariance a, b, c of `a dx^2 + 2 b dx dy + c dy^2`.
    pub conic: [R; 3],
    /// Opacity after the sigmoid.
    pub opacity: R,
    /// View depth.
    pub depth: R,
    /// What it is sorted by.
    pub key: R,
    /// Unit vector from the camera to the mean.
    pub dir: [R; 3],
    /// Tiles of 16 x 16 px that it may reach: x0, y0, x1, y1.
    pub tiles: [usize; 4],
}

const NEAR_DEPTH: f64 = 0.2;
const MIN_SPREAD: f64 = 0.1;

fn dot<R: Real>(a: [R; 3], b: [R; 3]) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Rotation matrix, rows, of a unit quaternion w, x, y, z.
fn rotation<R: Real>(q: [R; 4]) -> [[R; 3]; 3] {
    let [w, x, y, z] = q;
    let (one, two) = (R::of(1.0), R::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// Projected covariance xx, xy, yy before the blur (Zwicker et al. 2001).
fn covariance<R: Real>(view: &View<R>, p: [R; 3], scale: &[R], quat: &[R]) -> [R; 3] {
    let quat = [quat[0], quat[1], quat[2], quat[3]];
    let turn = rotation(if scale[3] == R::of(0.0) { normalize(quat) } else { quat });
    let mut rows = [[R::of(0.0); 3]; 2];
    for axis in 0..2 {
        let half_image = R::of(0.5 * view.size[axis] as f64) / view.focal[axis];
        let t = p[axis] / p[2];
        let t = view.rules.margin.map_or(t, |margin| t.max(-(margin * half_image)).min(margin * half_image));
        let focal = view.focal[axis] / p[2];
        for column in 0..3 {
            let world: [R; 3] = std::array::from_fn(|k| turn[k][column]);
            let in_camera = |row: usize| {
                let [a, b, c, _] = view.world_to_camera[row];
                dot([a, b, c], world)
            };
            rows[axis][column] = focal * (in_camera(axis) - t * in_camera(2)) * scale[column].exp();
        }
    }
    [dot(rows[0], rows[0]), dot(rows[0], rows[1]), dot(rows[1], rows[1])]
}

/// Tiles of 16 x 16 px that the square of half-side `radius` meets along one axis.
fn tile_span<R: Real>(centre: R, radius: R, pixels: usize) -> (usize, usize) {
    let tiles = pixels.div_ceil(16);
    let cut = |v: R| {
        let tile = v / R::of(16.0);
        (0..tiles).find(|&t| tile < R::of((t + 1) as f64)).unwrap_or(tiles)
    };
    (cut(centre - radius), cut(centre + radius + R::of(15.0)))
}

/// An ellipse (xx, xy, yy) whose axes differ as the rules want it; nothing where they do not draw it.
fn reshaped<R: Real>([a, b, c]: [R; 3], rules: &Rules<R>) -> Option<[R; 3]> {
    let half = R::of(0.5);
    let (mid, spread) = (half * (a + c), half * (a - c));
    let gap = (spread * spread + b * b).sqrt();
    let split = gap.max(rules.min_split);
    let (major, minor) = (mid + split, (mid - split).max(rules.min_minor));
    if minor <= R::of(0.0) || major < rules.min_major {
        return None;
    }
    if split == gap && mid - split >= rules.min_minor {
        return Some([a, b, c]);
    }
    let (x, y) = (b, split - spread);
    let size = (x * x + y * y).sqrt();
    let (x, y) = if size > R::of(0.0) { (x / size, y / size) } else { (R::of(1.0), R::of(0.0)) };
    Some([major * x * x + minor * y * y, (major - minor) * x * y, major * y * y + minor * x * x])
}

fn one<R: Real>(view: &View<R>, mean: &[R], scale: &[R], quat: &[R]) -> Option<Projected<R>> {
    let position = [mean[0], mean[1], mean[2]];
    let p: [R; 3] = view.world_to_camera.map(|[a, b, c, d]| dot([a, b, c], position) + d);
    if p.iter().any(|v| !v.f64().is_finite()) || p[2] <= R::of(NEAR_DEPTH) {
        return None;
    }
    let rules = &view.rules;
    let [a, b, c] = covariance(view, p, scale, quat);
    let sharp = a * c - b * b;
    let (a, c) = (a + rules.dilation, c + rules.dilation);
    let shrinks = sharp / (a * c - b * b);
    let plain = rules.min_split.max(rules.min_minor).max(rules.min_major) == R::of(0.0);
    let [a, b, c] = if plain { [a, b, c] } else { reshaped([a, b, c], rules)? };
    let det = a * c - b * b;
    let conic = [c / det, -b / det, a / det];
    let mean2d: [R; 2] = std::array::from_fn(|k| view.focal[k] * p[k] / p[2] + view.centre[k]);
    let opacity = R::of(1.0) / (R::of(1.0) + (-mean[3]).exp());
    let opacity = if rules.compensated { opacity * shrinks.max(R::of(0.0)).sqrt() } else { opacity };
    let numbers = [conic[0], conic[1], conic[2], mean2d[0], mean2d[1], opacity];
    if numbers.iter().any(|v| !v.f64().is_finite()) || opacity < rules.min_alpha {
        return None;
    }
    let off = |axis: usize| {
        let half_image = R::of(0.5 * view.size[axis] as f64);
        rules.guard.is_some_and(|guard| (mean2d[axis] + R::of(0.5) - half_image).abs() > guard * half_image)
    };
    if off(0) || off(1) {
        return None;
    }
    let mid = R::of(0.5) * (a + c);
    let spread = (mid * mid - det).max(R::of(MIN_SPREAD)).sqrt();
    let radius = (R::of(3.0) * (mid + spread).max(mid - spread).sqrt()).ceil();
    let along = |axis: usize| match rules.in_tiles {
        true => tile_span(mean2d[axis], radius, view.size[axis]),
        false => (0, view.size[axis].div_ceil(16)),
    };
    let ((x0, x1), (y0, y1)) = (along(0), along(1));
    if x0 >= x1 || y0 >= y1 {
        return None;
    }
    let [rx, ry, rz] = view.world_to_camera;
    let centre: [R; 3] = std::array::from_fn(|k| -(rx[k] * rx[3] + ry[k] * ry[3] + rz[k] * rz[3]));
    let towards: [R; 3] = std::array::from_fn(|k| mean[k] - centre[k]);
    let length = dot(towards, towards).sqrt().max(R::of(1e-12));
    let dir = towards.map(|v| v / length);
    let key = if rules.by_distance { length } else { p[2] };
    Some(Projected { mean2d, conic, opacity, depth: p[2], key, dir, tiles: [x0, y0, x1, y1] })
}

/// Projects splats (means, scales, quats, each `[N,4]`) by the rules of the view; `None` where culled.
#[must_use]
pub fn forward<R: Real>(view: &View<R>, means: &[R], scales: &[R], quats: &[R]) -> Vec<Option<Projected<R>>> {
    let rows = means.chunks_exact(4).zip(scales.chunks_exact(4)).zip(quats.chunks_exact(4));
    rows.map(|((mean, scale), quat)| one(view, mean, scale, quat)).collect()
}
