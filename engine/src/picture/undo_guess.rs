//! Guesses of what was done to a whole clip before it leaked, and undoing them.
//!
//! A clip that was turned or cropped shows CLIP other things than the clip that was marked, and most of the mark is
//! lost to it, though the pixels still hold it. Undone, it is read as before. What was done is not known, so several
//! guesses are read, and the one nearest to the claim counts. It was chosen with the claim in hand, so every p-value is
//! multiplied by the number of guesses (union bound; it holds however much they resemble each other).

use std::str::FromStr;

use guard4d_kernels::image::colour_map::ColourMap;
use guard4d_kernels::image::warp::{Sampling, Warp};
use guard4d_kernels::shape::ClipShape;
use serde::Serialize;

use super::distortion::brightness;

/// Degrees, but for none at all. Measured on marks of 32 bits: 2 degrees off cost 2 points of bits, 3 degrees 4.
const ROTATIONS: [f64; 8] = [-5.0, 5.0, -10.0, 10.0, -15.0, 15.0, -20.0, 20.0];
/// Shares of each side; a twentieth off costs nothing.
const CROPS: [f64; 4] = [0.9, 0.8, 0.7, 0.6];
/// Distance of the places that a part can have been cut from, in sides of the frame. Half of it off costs 3 to 9 points
/// of bits, all of it 13 to 19.
const PLACES: f64 = 0.025;
/// Factors of all colours.
const BRIGHTNESSES: [f64; 4] = [0.85, 0.7, 1.2, 1.4];

/// Distortions that every frame may have gone through alike, in the strengths of
/// [`crate::picture::distortion::DistortionKind`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UndoGuess {
    /// Degrees counterclockwise.
    pub rotation: f64,
    /// Share of each side that was kept.
    pub crop: f64,
    /// Where the middle of what was kept had been: right of the middle of the frame, in widths of the frame.
    pub right: f64,
    /// The same below it, in heights.
    pub below: f64,
    /// Factor of all colours.
    pub brightness: f64,
    /// Whether left and right were swapped.
    pub mirror: bool,
}

impl UndoGuess {
    /// Nothing.
    pub const NONE: Self = Self { rotation: 0.0, crop: 1.0, right: 0.0, below: 0.0, brightness: 1.0, mirror: false };

    /// Puts the picture back where it was; `fill` is what was cut off.
    pub(crate) fn warp_back(self, clip: ClipShape, fill: [f32; 3]) -> Warp {
        // What was done reads its input at middle + share · rotation · mirror of the place it writes; this is the
        // inverse.
        let (sin, cos) = self.rotation.to_radians().sin_cos();
        let side = if self.mirror { -1.0 } else { 1.0 };
        let inverse = [[cos * side, sin], [-sin * side, cos]].map(|row| row.map(|v| v / self.crop));
        let mut warp = Warp::about_the_middle(clip, inverse, Sampling::Bilinear, fill);
        let middle = [self.right * clip.width as f64, self.below * clip.height as f64];
        for (row, [x, y]) in warp.map.iter_mut().zip(inverse) {
            row[2] -= x * middle[0] + y * middle[1];
        }
        warp
    }

    /// Makes colours as bright as they were, but for those that were clamped.
    pub(crate) fn colours_back(self) -> ColourMap {
        brightness(1.0 / self.brightness)
    }
}

/// What can be guessed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum GuessKind {
    Rotation,
    /// About the middle.
    Crop,
    /// Anywhere.
    Window,
    Brightness,
    Mirror,
}

impl GuessKind {
    const ALL: [(Self, &str); 5] = [
        (Self::Rotation, "rotation"),
        (Self::Crop, "crop"),
        (Self::Window, "window"),
        (Self::Brightness, "brightness"),
        (Self::Mirror, "mirror"),
    ];

    /// `guess` as it is, and with each strength of this kind.
    fn guesses(self, guess: UndoGuess) -> Vec<UndoGuess> {
        let mut guesses = vec![guess];
        match self {
            Self::Rotation => guesses.extend(ROTATIONS.map(|rotation| UndoGuess { rotation, ..guess })),
            Self::Crop => guesses.extend(CROPS.map(|crop| UndoGuess { crop, ..guess })),
            Self::Window => {
                for crop in CROPS {
                    for below in places(crop) {
                        guesses.extend(places(crop).into_iter().map(|right| UndoGuess { crop, right, below, ..guess }));
                    }
                }
            }
            Self::Brightness => guesses.extend(BRIGHTNESSES.map(|brightness| UndoGuess { brightness, ..guess })),
            Self::Mirror => guesses.push(UndoGuess { mirror: true, ..guess }),
        }
        guesses
    }
}

/// Where along a side the middle of a part can have been that is `share` of it long.
fn places(share: f64) -> Vec<f64> {
    #[allow(clippy::cast_possible_truncation, reason = "less than half of a side, in fortieths")]
    let most = ((1.0 - share) / 2.0 / PLACES).round() as i32;
    (-most..=most).map(|i| f64::from(i) * PLACES).collect()
}

/// The word for whatever suits a film.
const AUTO: &str = "auto";

/// Kinds of distortions that a clip may have gone through; none by default.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct GuessSearch {
    kinds: Vec<GuessKind>,
    is_auto: bool,
}

impl GuessSearch {
    /// Whether the kinds are left to what [suits](Self::suited) the film.
    #[must_use]
    pub fn is_auto(&self) -> bool {
        self.is_auto
    }

    /// What is worth guessing of films that are framed by what they show, or that are not. Framing undoes turns and
    /// crops for nothing; an asset in a mirror looks like itself from elsewhere. Pictures alone decide, so that the
    /// guesses that are then tried are all that has to be paid for.
    #[must_use]
    pub fn suited(is_framed: bool) -> Self {
        let kinds = match is_framed {
            true => vec![GuessKind::Mirror],
            false => vec![GuessKind::Rotation, GuessKind::Crop, GuessKind::Mirror],
        };
        Self { kinds, is_auto: false }
    }

    /// Every combination of the strengths that are guessed; nothing at all comes first.
    #[must_use]
    pub fn guesses(&self) -> Vec<UndoGuess> {
        // Parts from anywhere are parts from the middle, too.
        let is_asked =
            |kind| self.kinds.contains(&kind) && (kind != GuessKind::Crop || !self.kinds.contains(&GuessKind::Window));
        let mut guesses = vec![UndoGuess::NONE];
        for (kind, _) in GuessKind::ALL.into_iter().filter(|(kind, _)| is_asked(*kind)) {
            guesses = guesses.into_iter().flat_map(|guess| kind.guesses(guess)).collect();
        }
        guesses
    }
}

/// Names of kinds with commas between them, such as `rotation,crop`, or `auto`.
impl FromStr for GuessSearch {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.trim() == AUTO {
            return Ok(Self { kinds: Vec::new(), is_auto: true });
        }
        let find = |name: &str| GuessKind::ALL.into_iter().find(|(_, known)| *known == name.trim());
        let kinds: Option<Vec<_>> = text.split(',').map(|name| find(name).map(|(kind, _)| kind)).collect();
        let names = GuessKind::ALL.map(|(_, name)| name).join(", ");
        let kinds = kinds.ok_or_else(|| format!("{AUTO}, or one or more of {names} are expected"))?;
        Ok(Self { kinds, is_auto: false })
    }
}
