//! A film that was filmed once more from a screen: a little from the side, dark about it, with other levels, and so
//! fine a screen that its own pixels do not show.

use glam::{DMat3, DVec2, DVec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;

/// Where the corners of the film are in the recording, from the upper left clockwise, in shares of its sides.
const CORNERS: [[f64; 2]; 4] = [[0.06, 0.05], [0.95, 0.08], [0.93, 0.94], [0.07, 0.96]];
/// Levels about the screen.
const DARK: u8 = 12;
/// Levels that were made for one screen and recorded for another, as a power.
const GAMMA: f64 = 2.2 / 1.8;

/// A recording of a screen, for films of one size.
#[derive(Clone, Copy, Debug)]
pub(super) struct Screen {
    /// From places in the film to places in the recording, px.
    to_recording: DMat3,
}

impl Screen {
    /// For films of so many pixels; recordings have as many.
    #[must_use]
    pub(super) fn of(width: u32, height: u32) -> Self {
        let sides = DMat3::from_diagonal(DVec3::new(f64::from(width), f64::from(height), 1.0));
        Self { to_recording: sides * from_square(CORNERS.map(DVec2::from)) * sides.inverse() }
    }

    /// Where a place of the film is in the recording, px.
    #[must_use]
    pub(super) fn seen(&self, place: DVec2) -> DVec2 {
        through(self.to_recording, place)
    }

    /// The recording of a frame.
    ///
    /// # Errors
    /// Never for a frame of that size.
    pub(super) fn recorded(&self, frame: &Frame) -> Result<Frame, EngineError> {
        let level = |level: f64| 255.0 * (level / 255.0).powf(GAMMA);
        warped(frame, self.to_recording.inverse(), level)
    }

    /// The frame of a recording, seen straight on, with the levels that it was recorded with.
    ///
    /// # Errors
    /// As [`recorded`](Self::recorded).
    pub(super) fn undone(&self, frame: &Frame) -> Result<Frame, EngineError> {
        warped(frame, self.to_recording, |level| level)
    }
}

/// From the unit square to a quadrilateral (Heckbert 1989), corners from the upper left clockwise.
fn from_square([a, b, c, d]: [DVec2; 4]) -> DMat3 {
    let (right, down, rest) = (b - c, d - c, a - b + c - d);
    let whole = right.perp_dot(down);
    let (g, h) = (rest.perp_dot(down) / whole, right.perp_dot(rest) / whole);
    DMat3::from_cols((b - a + g * b).extend(g), (d - a + h * d).extend(h), a.extend(1.0))
}

fn through(map: DMat3, place: DVec2) -> DVec2 {
    let seen = map * place.extend(1.0);
    seen.truncate() / seen.z
}

/// A frame whose pixels are those of another where `from` says, bilinear, and dark beyond.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "levels, and pixels within a frame")]
fn warped(frame: &Frame, from: DMat3, level: impl Fn(f64) -> f64) -> Result<Frame, EngineError> {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let mut rgb = Vec::with_capacity(frame.rgb().len());
    for at in 0..width * height {
        let centre = DVec2::new((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        let there = through(from, centre);
        if there.x < 0.0 || there.y < 0.0 || there.x > width as f64 || there.y > height as f64 {
            rgb.extend([DARK; 3]);
            continue;
        }
        let last = DVec2::new((width - 1) as f64, (height - 1) as f64);
        let there = (there - 0.5).clamp(DVec2::ZERO, last);
        let (x, y) = (there.x as usize, there.y as usize);
        let part = there - there.floor();
        let of = |x: usize, y: usize, channel: usize| {
            f64::from(frame.rgb()[3 * (y.min(height - 1) * width + x.min(width - 1)) + channel])
        };
        rgb.extend([0, 1, 2].map(|channel| {
            let [above, below] = [y, y + 1].map(|y| {
                let (left, right) = (of(x, y, channel), of(x + 1, y, channel));
                left + part.x * (right - left)
            });
            level(above + part.y * (below - above)).round() as u8
        }));
    }
    Frame::new(frame.width(), frame.height(), rgb)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_go_where_they_are_recorded_and_come_back() {
        let screen = Screen::of(200, 100);
        for (corner, [x, y]) in [[0.0, 0.0], [200.0, 0.0], [200.0, 100.0], [0.0, 100.0]].into_iter().zip(CORNERS) {
            let apart = screen.seen(DVec2::from(corner)).distance(DVec2::new(200.0 * x, 100.0 * y));
            assert!(apart < 1e-9, "{corner:?}: {apart}");
        }
        // A ramp, which interpolation keeps; the recording has other levels and nothing else.
        let ramp = (0..200 * 100).flat_map(|at: u32| [u8::try_from(at % 200).expect("a level"); 3]).collect();
        let frame = Frame::new(200, 100, ramp).expect("of its size");
        let back = screen.undone(&screen.recorded(&frame).expect("a frame")).expect("a frame");
        for at in [50 * 200 + 20, 50 * 200 + 100, 30 * 200 + 180] {
            let expected = 255.0 * (f64::from(frame.rgb()[3 * at]) / 255.0).powf(GAMMA);
            let off = (f64::from(back.rgb()[3 * at]) - expected).abs();
            // Rounded twice.
            assert!(off < 1.6, "{at}: {off}");
        }
    }
}
