//! Twin of `image/crop`.

use crate::image::crop::{Crop, Window};
use crate::reference::real::Real;

/// Calls `pair(cell element, clip element, colour)` for every colour of the window that lies in a cell.
fn each_pair(crop: &Crop, mut pair: impl FnMut(usize, usize, usize)) {
    let Crop { window: Window { frame, frames, corner, size, full }, cells } = *crop;
    for f in 0..frames {
        for y in 0..size.height {
            for x in 0..size.width {
                let (row, column) = (y + cells.padding, x + cells.padding);
                let (cell_y, cell_x) = (row / cells.patch, column / cells.patch);
                if cell_y >= cells.grid[0] || cell_x >= cells.grid[1] {
                    continue;
                }
                let cell = (f * cells.grid[0] + cell_y) * cells.grid[1] + cell_x;
                let inner = row % cells.patch * cells.patch + column % cells.patch;
                let pixel = ((frame + f) * full.height + corner[0] + y) * full.width + corner[1] + x;
                for colour in 0..3 {
                    pair(cell * cells.channels() + inner * 4 + colour, pixel * 4 + colour, colour);
                }
            }
        }
    }
}

/// Cells of the window `[frames, grid, grid, channels]`.
pub fn forward<R: Real>(crop: &Crop, mean: [R; 3], std: [R; 3], x: &[R]) -> Vec<R> {
    let mut y = vec![R::of(0.0); crop.cells.len(crop.window.frames)];
    each_pair(crop, |cell, pixel, colour| y[cell] = (x[pixel] - mean[colour]) / std[colour]);
    y
}

/// Adds the gradient to `v_x` `[F, H, W, 4]`; the fourth channel of the window becomes 0.
pub fn backward<R: Real>(crop: &Crop, std: [R; 3], v_y: &[R], v_x: &mut [R]) {
    each_pair(crop, |cell, pixel, colour| v_x[pixel] += v_y[cell] / std[colour]);
    let Window { frame, frames, corner, size, full } = crop.window;
    for f in 0..frames {
        for y in 0..size.height {
            for x in 0..size.width {
                v_x[(((frame + f) * full.height + corner[0] + y) * full.width + corner[1] + x) * 4 + 3] = R::of(0.0);
            }
        }
    }
}
