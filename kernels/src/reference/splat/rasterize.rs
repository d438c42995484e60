//! Twin of `splat/rasterize_*`.

use std::collections::HashSet;

use super::project::Projected;
use super::tile_bin::{TILE, pruned_lists};
use super::traverse::{Hit, Screen, meet, traverse};
use crate::reference::real::Real;

/// As [`traverse`], and where one of the `factors` of the weights is not finite also the terms that vanish otherwise:
/// in the kernels every splat of a tile's list meets all pixels of the tile, with weight 0 where it is skipped, and 0
/// times what is not finite is NaN.
fn each_term<R: Real>(
    splats: &[Option<Projected<R>>],
    screen: &Screen<R>,
    factors: &[R],
    mut visit: impl FnMut(Hit<R>),
) -> Vec<R> {
    if factors.iter().all(|v| v.f64().is_finite()) {
        return traverse(splats, screen, visit);
    }
    let mut met = HashSet::new();
    let transmittance = traverse(splats, screen, |hit| {
        met.insert((hit.splat, hit.pixel));
        visit(hit);
    });
    let [width, height] = screen.size;
    let tiles_x = width.div_ceil(TILE);
    for (tile, list) in pruned_lists(splats, screen).into_iter().enumerate() {
        let (left, top) = (tile % tiles_x * TILE, tile / tiles_x * TILE);
        for pixel in (0..TILE * TILE).map(|i| (left + i % TILE, top + i / TILE)) {
            let inside = pixel.0 < width && pixel.1 < height;
            let pixel = pixel.1 * width + pixel.0;
            for splat in list.iter().copied().filter(|&s| inside && !met.contains(&(s, pixel))) {
                visit(Hit { splat, pixel, weight: R::of(0.0) });
            }
        }
    }
    transmittance
}

/// Image `[H,W,4]`: rgb over the background, final transmittance. `colours` `[N,4]`.
#[must_use]
pub fn forward<R: Real>(
    splats: &[Option<Projected<R>>],
    colours: &[R],
    background: [R; 3],
    screen: &Screen<R>,
) -> Vec<R> {
    let mut image = vec![R::of(0.0); 4 * screen.size[0] * screen.size[1]];
    let transmittance = each_term(splats, screen, colours, |hit| {
        for k in 0..3 {
            image[4 * hit.pixel + k] += hit.weight * colours[4 * hit.splat + k];
        }
    });
    for (pixel, t) in image.chunks_exact_mut(4).zip(transmittance) {
        for k in 0..3 {
            pixel[k] += t * background[k];
        }
        pixel[3] = t;
    }
    image
}

/// The same through a framebuffer of 8 bits: back to front, each splat rounded to steps of 1/255.
#[must_use]
pub fn forward_in_bytes<R: Real>(
    splats: &[Option<Projected<R>>],
    colours: &[R],
    background: [R; 3],
    screen: &Screen<R>,
) -> Vec<R> {
    let steps = R::of(255.0);
    let stored =
        |channel: R| R::of((steps * channel.max(R::of(0.0)).min(R::of(1.0)) + R::of(0.5)).f64().floor()) / steps;
    let mut met = vec![Vec::new(); screen.size[0] * screen.size[1]];
    meet(splats, screen, |splat, pixel, alpha| met[pixel].push((splat, alpha)));
    let mut image = Vec::new();
    for met in met {
        let (mut pixel, mut transmittance) = (background.map(stored), R::of(1.0));
        for (splat, alpha) in met.into_iter().rev() {
            for k in 0..3 {
                let given = (alpha * colours[4 * splat + k]).min(R::of(1.0));
                pixel[k] = stored(given + (R::of(1.0) - alpha) * pixel[k]);
            }
            transmittance = transmittance * (R::of(1.0) - alpha);
        }
        image.extend(pixel.into_iter().chain([transmittance]));
    }
    image
}

/// Gradient `[N,4]` of the colours from `v_image` `[H,W,4]`, whose fourth channel is unread.
#[must_use]
pub fn backward<R: Real>(splats: &[Option<Projected<R>>], v_image: &[R], screen: &Screen<R>) -> Vec<R> {
    let mut v_colours = vec![R::of(0.0); 4 * splats.len()];
    each_term(splats, screen, v_image, |hit| {
        for k in 0..3 {
            v_colours[4 * hit.splat + k] += hit.weight * v_image[4 * hit.pixel + k];
        }
    });
    v_colours
}
