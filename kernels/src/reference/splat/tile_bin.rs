//! Twin of `splat/tile_bin_*` and `splat/rasterize_visit`: lists by definition, pixel by pixel.

use super::project::Projected;
use super::traverse::{Hit, Screen, traverse};
use crate::reference::real::Real;

/// Side of a tile in px.
pub const TILE: usize = 8;

/// For each tile the splats, front to back, that reach a pixel of it which has not stopped.
#[must_use]
pub fn pruned_lists<R: Real>(splats: &[Option<Projected<R>>], screen: &Screen<R>) -> Vec<Vec<usize>> {
    let size = screen.size;
    let tiles_x = size[0].div_ceil(TILE);
    let mut lists = vec![Vec::new(); tiles_x * size[1].div_ceil(TILE)];
    traverse(splats, screen, |hit: Hit<R>| {
        let (x, y) = (hit.pixel % size[0], hit.pixel / size[0]);
        let list: &mut Vec<usize> = &mut lists[(y / TILE) * tiles_x + x / TILE];
        if list.last() != Some(&hit.splat) {
            list.push(hit.splat);
        }
    });
    lists
}
