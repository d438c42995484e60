//! Splats over pixels, front to back.

use super::project::Projected;
use crate::reference::real::Real;

const MAX_ALPHA: f64 = 0.99;
const MIN_ALPHA: f64 = 1.0 / 255.0;
const STOP_TRANSMITTANCE: f64 = 1e-4;

/// Splats in the order they are blended: by depth, ties by index.
#[must_use]
pub fn depth_order<R: Real>(splats: &[Option<Projected<R>>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..splats.len()).filter(|&i| splats[i].is_some()).collect();
    let depth = |i: usize| splats[i].as_ref().map_or(R::of(0.0), |s| s.depth);
    order.sort_by(|&a, &b| depth(a).partial_cmp(&depth(b)).unwrap_or(std::cmp::Ordering::Equal));
    order
}

/// A splat meets a pixel that has not stopped.
#[derive(Clone, Copy, Debug)]
pub struct Hit<R> {
    /// Index of the splat.
    pub splat: usize,
    /// Row-major index of the pixel.
    pub pixel: usize,
    /// `alpha T`, zero where the pixel stops before this splat.
    pub weight: R,
}

/// Walks splats front to back over the pixels of their 16 x 16 tiles (Kerbl et al. 2023) and returns
/// the final transmittance `[H,W]`; `size` is width, height.
pub fn traverse<R: Real>(splats: &[Option<Projected<R>>], size: [usize; 2], mut visit: impl FnMut(Hit<R>)) -> Vec<R> {
    let [width, height] = size;
    let mut transmittance = vec![R::of(1.0); width * height];
    let mut stopped = vec![false; width * height];
    for splat in depth_order(splats) {
        let Some(s) = &splats[splat] else { continue };
        let [x0, y0, x1, y1] = s.tiles.map(|t| 16 * t);
        for y in y0..y1.min(height) {
            for x in x0..x1.min(width) {
                let pixel = y * width + x;
                let (dx, dy) = (s.mean2d[0] - R::of(x as f64), s.mean2d[1] - R::of(y as f64));
                let [a, b, c] = s.conic;
                let power = R::of(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy;
                let alpha = (s.opacity * power.exp()).min(R::of(MAX_ALPHA));
                if stopped[pixel] || power > R::of(0.0) || alpha < R::of(MIN_ALPHA) {
                    continue;
                }
                let next = transmittance[pixel] * (R::of(1.0) - alpha);
                stopped[pixel] = next < R::of(STOP_TRANSMITTANCE);
                let weight = if stopped[pixel] { R::of(0.0) } else { alpha * transmittance[pixel] };
                if !stopped[pixel] {
                    transmittance[pixel] = next;
                }
                visit(Hit { splat, pixel, weight });
            }
        }
    }
    transmittance
}
