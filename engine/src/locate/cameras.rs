//! What was found of some frames as the cameras of all.

use super::film::Track;
use super::pose::Pose;
use super::reading::Reading;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::media::framing::Rect;
use crate::scene::camera::View;
use crate::scene::{Camera, CameraSet, FrameSize};

impl Track {
    /// The camera and moment of each frame of the film. Frames that were not looked at, and those that were not found,
    /// are between those that were, and said to be no more than a guess. None of no frames.
    ///
    /// # Errors
    /// Never for what was read of a film.
    pub fn cameras(&self, reading: &Reading) -> Result<Option<CameraSet>, EngineError> {
        let mut views = Vec::new();
        for frame in 0..reading.frames {
            let (at, beyond) = (frame / reading.every, frame % reading.every);
            let Some(pose) = self.pose(at, beyond as f64 / reading.every as f64) else { return Ok(None) };
            let camera = pose.camera(FrameSize::new(reading.picture.width, reading.picture.height)?);
            let camera = if self.is_mirrored { camera.mirrored() } else { camera };
            views.push(View {
                name: format!("frame_{frame:05}"),
                camera: in_frame(camera, reading.picture, reading.size),
                times: vec![narrow(pose.time)],
                located: beyond == 0 && self.frames.get(at).is_some_and(Option::is_some),
            });
        }
        Ok(Some(CameraSet { views, in_sequence: true }))
    }

    /// Between one picture that was looked at and the next: as far as that is known within the shot, else as near to
    /// it as anything is.
    fn pose(&self, at: usize, beyond: f64) -> Option<Pose> {
        let known = |at: usize| self.frames.get(at).copied().flatten().map(|fit| fit.pose);
        let of_shot = |at: &usize| self.shots.iter().position(|shot| shot.contains(at));
        let shot = of_shot(&at.min(self.frames.len().saturating_sub(1)));
        let is_here = |other: &usize| of_shot(other) == shot;
        let before = (0..=at).rev().filter(is_here).find_map(|other| Some((other, known(other)?)));
        let behind = (at + 1..self.frames.len()).filter(is_here).find_map(|other| Some((other, known(other)?)));
        match (before, behind) {
            (Some((from, a)), Some((to, b))) => {
                let part = (at as f64 + beyond - from as f64) / (to - from) as f64;
                Some(a.toward(&b, part))
            }
            (Some((_, pose)), None) | (None, Some((_, pose))) => Some(pose),
            (None, None) => {
                let nearest = (0..self.frames.len()).filter(|other| known(*other).is_some());
                nearest.min_by_key(|other| other.abs_diff(at)).and_then(known).or(self.guess.map(|guess| guess.pose))
            }
        }
    }
}

/// A camera of a part of a frame as one of all of it.
fn in_frame(camera: Camera, part: Rect, size: FrameSize) -> Camera {
    let [x, y] = [part.x, part.y].map(|side| narrow(f64::from(side)));
    Camera { cx: camera.cx + x, cy: camera.cy + y, width: size.width(), height: size.height(), ..camera }
}
