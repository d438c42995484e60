//! Small pictures in colour, as a first look compares them: what is of one brightness may be of several colours.

use super::gray::Gray;
use crate::media::Frame;
use crate::media::frames::LUMA;

/// Channels: luma, and how much bluer and redder than it a pixel is.
pub const CHANNELS: usize = 3;
/// Luma, blue less that, and red less that.
const WAYS: [[f32; 3]; CHANNELS] = [LUMA, [-LUMA[0], -LUMA[1], 1.0 - LUMA[2]], [1.0 - LUMA[0], -LUMA[1], -LUMA[2]]];
/// The longer side of a film's, px: more than the largest picture that is looked at has.
const LONGEST_PX: u32 = 192;

/// A picture of some dozens of pixels, channel by channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Thumbnail {
    /// The channels, which are of one size.
    pub channels: [Gray; CHANNELS],
}

impl Thumbnail {
    /// Of a frame.
    #[must_use]
    pub fn of_frame(frame: &Frame) -> Self {
        let (width, height) = (frame.width() as usize, frame.height() as usize);
        let rgb = [0, 1, 2].map(|channel| {
            let values = frame.rgb().chunks_exact(3).map(|rgb| f32::from(rgb[channel]) / 255.0).collect();
            Gray { width, height, values }.within(LONGEST_PX)
        });
        Self::of_rgb(&rgb)
    }

    /// Of rendered pixels `[H, W, 4]`, as films show them, at another size.
    #[must_use]
    pub fn of_pixels(drawn: [usize; 2], pixels: &[f32], size: [usize; 2]) -> Self {
        let [width, height] = drawn;
        let rgb = [0, 1, 2].map(|channel| {
            let values = pixels.chunks_exact(4).map(|rgba| rgba[channel].clamp(0.0, 1.0)).collect();
            Gray { width, height, values }.resized(size[0], size[1])
        });
        Self::of_rgb(&rgb)
    }

    fn of_rgb(rgb: &[Gray; 3]) -> Self {
        let [red, green, blue] = rgb;
        let along = |[r, g, b]: [f32; 3]| {
            let pixels = red.values.iter().zip(&green.values).zip(&blue.values);
            Gray { values: pixels.map(|((red, green), blue)| r * red + g * green + b * blue).collect(), ..*red }
        };
        Self { channels: WAYS.map(along) }
    }

    /// Pixels across and down.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        [self.channels[0].width, self.channels[0].height]
    }

    /// Left and right exchanged.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        Self { channels: self.channels.each_ref().map(Gray::mirrored) }
    }

    /// The picture at another size.
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        Self { channels: self.channels.each_ref().map(|channel| channel.resized(width, height)) }
    }
}
