//! A frame of a film whose camera is known.

use crate::media::Frame;
use crate::scene::Camera;

/// A frame of a film, and from where and when it was taken.
#[derive(Clone, Copy, Debug)]
pub struct Shot<'a> {
    /// Its pixels.
    pub frame: &'a Frame,
    /// Its camera, of the frame's size.
    pub camera: Camera,
    /// Its time, 0 to 1.
    pub time: f32,
}
