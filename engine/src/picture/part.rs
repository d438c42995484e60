//! Parts of frames: what a frame by itself says of how it is to be cut, and what of it CLIP is shown.

use std::collections::BTreeMap;

use guard4d_kernels::image::resize::{ImageSize, Region};
use serde::Serialize;

use super::foreground::NotFound;

/// Turns that are looked for, degrees counterclockwise, upright in the middle. A thumbnail's cells are so large that
/// between two of them lies nothing of its own.
pub(super) const TURNS_DEG: [f64; 17] =
    [-40.0, -35.0, -30.0, -25.0, -20.0, -15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0];

/// Where something is that was `[right, below]` of the middle, in a picture that was turned about it.
pub(super) fn turned([right, below]: [f64; 2], turn_deg: f64) -> [f64; 2] {
    // Counterclockwise as seen; rows grow downwards.
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    [cos * right + sin * below, cos * below - sin * right]
}

/// A window in pixels from the upper left corner of a frame; it may reach beyond it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Its middle: right of the frame's left edge, and below its upper edge.
    pub middle: [f64; 2],
    /// Its width and height.
    pub sides: [f64; 2],
    /// Degrees counterclockwise by which it is turned about its middle.
    pub turn_deg: f64,
}

impl Window {
    /// All of a frame.
    #[must_use]
    pub fn whole(size: ImageSize) -> Self {
        let sides = [size.width, size.height].map(|n| n as f64);
        Self { middle: sides.map(|side| side / 2.0), sides, turn_deg: 0.0 }
    }

    /// The upright region of a frame that holds it.
    #[must_use]
    pub fn region(self) -> Region {
        let Self { middle: [x, y], sides: [across, down], turn_deg } = self;
        let (sin, cos) = turn_deg.to_radians().sin_cos();
        let (width, height) = ((cos * across).abs() + (sin * down).abs(), (sin * across).abs() + (cos * down).abs());
        Region { x: x - width / 2.0, y: y - height / 2.0, width, height }
    }

    /// Where its places are in [`Self::region`], as a linear map about the middle of both: from sides of the window to
    /// sides of the region.
    #[must_use]
    pub fn in_region(self) -> [[f64; 2]; 2] {
        let (Region { width, height, .. }, [across, down]) = (self.region(), self.sides);
        let ([xx, yx], [xy, yy]) = (turned([across, 0.0], self.turn_deg), turned([0.0, down], self.turn_deg));
        [[xx / width, xy / width], [yx / height, yy / height]]
    }

    /// How far two windows are apart, whatever their turns: in sides of the other, or as the logarithm of a ratio of
    /// sides, whichever is more.
    pub(super) fn apart(self, other: Self) -> f64 {
        let off = |i: usize| (self.middle[i] - other.middle[i]).abs() / other.sides[i];
        let size = |i: usize| (self.sides[i] / other.sides[i]).ln().abs();
        [off(0), off(1), size(0), size(1)].into_iter().max_by(f64::total_cmp).unwrap_or(0.0)
    }

    /// Whether two windows are as near as `[places, sizes]`, whatever their turns.
    pub(super) fn is_near(self, other: Self, [places, sizes]: [f64; 2]) -> bool {
        (0..2).all(|i| {
            let off = (self.middle[i] - other.middle[i]).abs() <= places * other.sides[i];
            off && (self.sides[i] / other.sides[i]).ln().abs() <= sizes
        })
    }
}

/// The part of a frame that CLIP is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// A window.
    Window(Window),
    /// All of it: it is framed as training was, or nothing else was asked for.
    All,
    /// All of it, since nothing was found to cut out.
    Fallback(NotFound),
}

impl Part {
    /// What is shown of a frame of this size.
    #[must_use]
    pub fn window(self, size: ImageSize) -> Window {
        match self {
            Self::Window(window) => window,
            Self::All | Self::Fallback(_) => Window::whole(size),
        }
    }
}

/// What a frame by itself says of how it is to be cut.
#[derive(Clone, Debug, PartialEq)]
pub enum Look {
    /// A window for each turn that is looked for.
    Fits(Vec<Fit>),
    /// Nothing, since nothing was found to cut out.
    Nothing(NotFound),
}

impl Look {
    /// The window of the turn of this number, if there is one.
    pub(super) fn window(&self, turn: usize) -> Option<Window> {
        if let Self::Fits(fits) = self { fits.get(turn).map(|fit| fit.window) } else { None }
    }
}

/// The window of a frame that is turned in a certain way, and how well the frame then fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Squared distance from the nearest known view.
    pub distance: f64,
    /// The window.
    pub window: Window,
}

/// How the frames of a film were cut.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Framings {
    /// Frames that were cut to a window.
    pub cut: u32,
    /// Frames of these that were turned upright.
    pub turned: u32,
    /// Frames that are framed as training was.
    pub usual: u32,
    /// Frames in which the asset was not found, and which were shown whole, by the reason.
    pub not_found: BTreeMap<NotFound, u32>,
}

impl Framings {
    /// Whether most frames were framed by what they show, or by their cameras.
    #[must_use]
    pub fn are_framed(&self) -> bool {
        let found = self.cut + self.usual;
        found > self.not_found.values().sum()
    }

    /// Counts the frames of a film.
    #[must_use]
    pub fn of(parts: &[Part]) -> Self {
        let mut all = Self::default();
        for part in parts {
            match *part {
                Part::Window(window) => {
                    all.cut += 1;
                    all.turned += u32::from(window.turn_deg != 0.0);
                }
                Part::Fallback(why) => *all.not_found.entry(why).or_default() += 1,
                Part::All => all.usual += 1,
            }
        }
        all
    }
}
