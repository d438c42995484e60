//! Splats over pixels, front to back.

use super::project::Projected;
use super::rules::Rules;
use crate::reference::real::Real;

const STOP_TRANSMITTANCE: f64 = 1e-4;

/// What splats are drawn on, and how.
#[derive(Clone, Copy, Debug)]
pub struct Screen<R> {
    /// Width and height in px.
    pub size: [usize; 2],
    /// How splats are blended.
    pub rules: Rules<R>,
}

/// Splats in the order they are blended: by their keys, ties by index.
#[must_use]
pub fn depth_order<R: Real>(splats: &[Option<Projected<R>>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..splats.len()).filter(|&i| splats[i].is_some()).collect();
    let key = |i: usize| splats[i].as_ref().map_or(R::of(0.0), |s| s.key);
    order.sort_by(|&a, &b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal));
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

/// Opacity of a splat whose natural exponent at a pixel is `power`; nothing where it does not count.
fn alpha_at<R: Real>(opacity: R, power: R, rules: &Rules<R>) -> Option<R> {
    let within = power <= R::of(0.0) && rules.reach.is_none_or(|reach| power >= R::of(-0.5) * reach * reach);
    let falloff = (power.exp() - rules.foot) / (R::of(1.0) - rules.foot);
    let alpha = (opacity * falloff).min(rules.max_alpha);
    (within && alpha >= rules.min_alpha).then_some(alpha)
}

/// Walks splats front to back over the pixels of their 16 x 16 tiles (Kerbl et al. 2023): `visit` takes each splat, a
/// pixel, and its alpha there where that counts.
pub fn meet<R: Real>(splats: &[Option<Projected<R>>], screen: &Screen<R>, mut visit: impl FnMut(usize, usize, R)) {
    let Screen { size: [width, height], rules } = *screen;
    for splat in depth_order(splats) {
        let Some(s) = &splats[splat] else { continue };
        let [x0, y0, x1, y1] = s.tiles.map(|t| 16 * t);
        for y in y0..y1.min(height) {
            for x in x0..x1.min(width) {
                let (dx, dy) = (s.mean2d[0] - R::of(x as f64), s.mean2d[1] - R::of(y as f64));
                let [a, b, c] = s.conic;
                let power = R::of(-0.5) * (a * dx * dx + c * dy * dy) - b * dx * dy;
                if let Some(alpha) = alpha_at(s.opacity, power, &rules) {
                    visit(splat, y * width + x, alpha);
                }
            }
        }
    }
}

/// The same until pixels stop; returns the final transmittance `[H,W]`.
pub fn traverse<R: Real>(splats: &[Option<Projected<R>>], screen: &Screen<R>, mut visit: impl FnMut(Hit<R>)) -> Vec<R> {
    let [width, height] = screen.size;
    let mut transmittance = vec![R::of(1.0); width * height];
    let mut stopped = vec![false; width * height];
    meet(splats, screen, |splat, pixel, alpha| {
        if stopped[pixel] {
            return;
        }
        let next = transmittance[pixel] * (R::of(1.0) - alpha);
        stopped[pixel] = next < R::of(STOP_TRANSMITTANCE);
        let drawn = !stopped[pixel] || screen.rules.ends_behind;
        let weight = if drawn { alpha * transmittance[pixel] } else { R::of(0.0) };
        if drawn {
            transmittance[pixel] = next;
        }
        visit(Hit { splat, pixel, weight });
    });
    transmittance
}
