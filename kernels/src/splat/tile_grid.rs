//! Images in tiles, and the workgroups that walk them.

use crate::error::KernelError;
use crate::shape::dim;
use crate::vk::Grid;

/// Pixels along one side of the tiles that are blended by one workgroup.
pub(super) const TILE: u32 = 8;
/// Most tiles of an image: one invocation may walk a splat's tiles by four within lavapipe's loop limit.
const MAX_TILES: u32 = 4 * 65_535;

/// An image cut into 8 x 8 tiles, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileGrid {
    /// Image width in px.
    pub width: u32,
    /// Image height in px.
    pub height: u32,
}

impl TileGrid {
    /// The grid of an image.
    ///
    /// # Errors
    /// [`KernelError::Shape`] when the image is empty or has more tiles than a kernel may walk.
    pub fn new(width: u32, height: u32) -> Result<Self, KernelError> {
        let tiles = u64::from(width.div_ceil(TILE)) * u64::from(height.div_ceil(TILE));
        if tiles == 0 || tiles > u64::from(MAX_TILES) {
            return Err(KernelError::Shape {
                kernel: "splat/rasterize",
                buffer: "image",
                got: format!("{width} x {height} px"),
                expected: format!("1 to {MAX_TILES} tiles of {TILE} x {TILE} px"),
            });
        }
        Ok(Self { width, height })
    }

    /// Tiles along x.
    #[must_use]
    pub fn tiles_x(self) -> u32 {
        self.width.div_ceil(TILE)
    }

    /// Tiles along y.
    #[must_use]
    pub fn tiles_y(self) -> u32 {
        self.height.div_ceil(TILE)
    }

    /// All tiles.
    #[must_use]
    pub fn num_tiles(self) -> u32 {
        self.tiles_x() * self.tiles_y()
    }

    /// Pixels.
    #[must_use]
    pub fn num_pixels(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// One workgroup per tile, a lane for each of its columns.
pub(super) fn workgroups(tiles: usize) -> Grid {
    Grid::threads(tiles * TILE as usize)
}

/// One workgroup per tile, an invocation for each of its pixels.
pub(super) fn pixel_workgroups(tiles: usize) -> Grid {
    Grid::threads(tiles * (TILE * TILE) as usize)
}

/// Step between the tiles of consecutive workgroups, coprime to their number: about its root, so that
/// the product with a workgroup index stays below 2³².
pub(super) fn stride(tiles: usize) -> u32 {
    let tiles = dim(tiles);
    let gcd = |mut a: u32, mut b: u32| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    (tiles.isqrt() | 1..).step_by(2).find(|&s| gcd(s, tiles) == 1).unwrap_or(1)
}
