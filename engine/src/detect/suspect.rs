//! What is under suspicion, and what is read of it.

use std::path::PathBuf;

use super::clip_reader::{ClipReader, SeenClip};
use super::exhibit::{Exhibit, choose};
use crate::base::digest::Digest;
use crate::error::EngineError;
use crate::evidence::reading::Reading;
use crate::media::framing::Rect;
use crate::media::{Frame, Integrity};
use crate::picture::known_cameras::KnownCameras;
use crate::picture::part::Framings;
use crate::picture::undo_guess::UndoGuess;
use crate::scene::{CameraSet, Model};
use crate::watermark::extractor::reader::ClipFeatures;

/// What is under suspicion.
#[derive(Debug)]
pub enum Suspect {
    /// A video file, or a folder of pictures in its place.
    Video(PathBuf),
    /// The same, whose cameras are known.
    Filmed {
        /// The video or folder.
        path: PathBuf,
        /// Its cameras.
        cameras: KnownCameras,
    },
    /// Frames of one clip.
    Frames {
        /// For the report.
        name: String,
        /// All of one size.
        frames: Vec<Frame>,
    },
    /// A model, of which frames are rendered. How they are read is not for [`crate::media::ReadOptions`] to say: all
    /// of them are, whole.
    Model {
        /// For the report.
        name: String,
        /// With the background that it is rendered before.
        model: Box<Model>,
        /// Each of their clips counts as one, see [`CameraSet::clips`].
        cameras: CameraSet,
    },
}

/// A suspect film, and the camera and time of each of its frames.
#[derive(Clone, Debug)]
pub struct FilmedSuspect {
    /// The video or folder.
    pub path: PathBuf,
    /// Its cameras.
    pub cameras: CameraSet,
}

/// What was read of all suspect clips.
pub(super) struct Suspects {
    /// Of all clips together, after each guess of what was done to them is undone.
    features: Vec<ClipFeatures>,
    /// Shorter side of the smallest frame.
    side_px: u32,
    frames: usize,
    damage: Vec<String>,
    clips: Vec<SuspectClip>,
    /// Some frames of each.
    exhibits: Vec<Vec<Exhibit>>,
}

/// What was read of one of them.
pub(super) struct SuspectClip {
    name: String,
    /// After each guess is undone.
    readings: Vec<Reading>,
    framings: Framings,
    size_px: (u32, u32),
    cut: Option<Rect>,
    content: Option<Digest>,
}

impl Suspects {
    /// Reads suspects one after the other, with each of `guesses` undone.
    ///
    /// # Errors
    /// Those of reading a clip.
    pub(super) fn read(
        reader: &mut ClipReader<'_>,
        suspects: &[Suspect],
        guesses: &[UndoGuess],
    ) -> Result<Self, EngineError> {
        let features = vec![ClipFeatures::default(); guesses.len()];
        let mut all = Self {
            features,
            side_px: u32::MAX,
            frames: 0,
            damage: Vec::new(),
            clips: Vec::new(),
            exhibits: Vec::new(),
        };
        let num_bits = reader.num_bits();
        for suspect in suspects {
            match suspect {
                Suspect::Video(path) => {
                    all.add(reader.suspect_video(path, None, guesses)?, num_bits, Some(Digest::of_path(path)?))?;
                }
                Suspect::Filmed { path, cameras } => {
                    all.add(
                        reader.suspect_video(path, Some(cameras), guesses)?,
                        num_bits,
                        Some(Digest::of_path(path)?),
                    )?;
                }
                Suspect::Frames { name, frames } => all.add(reader.frames(name, frames, guesses)?, num_bits, None)?,
                Suspect::Model { name, model, cameras } => {
                    reader.model(name, model, cameras, guesses, &mut |clip| all.add(clip, num_bits, None))?;
                }
            }
        }
        Ok(all)
    }

    /// Whether all of them are framed, be it by what they show, by their cameras, or because they are filmed for it.
    ///
    /// # Errors
    /// Those of decoding a film.
    pub(super) fn are_framed(reader: &mut ClipReader<'_>, suspects: &[Suspect]) -> Result<bool, EngineError> {
        for suspect in suspects {
            let is_framed = match suspect {
                Suspect::Video(path) => reader.video_framings(path)?.are_framed(),
                Suspect::Frames { frames, .. } => reader.framings(frames).are_framed(),
                Suspect::Filmed { .. } | Suspect::Model { .. } => true,
            };
            if !is_framed {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// What all of them show with each guess undone, in the guesses' order.
    pub(super) fn features(&self) -> &[ClipFeatures] {
        &self.features
    }

    /// Shorter side of the smallest frame.
    pub(super) fn side_px(&self) -> u32 {
        self.side_px
    }

    /// Frames read.
    pub(super) fn frames(&self) -> usize {
        self.frames
    }

    /// What decoders of damaged videos said.
    pub(super) fn damage(&self) -> &[String] {
        &self.damage
    }

    /// Each clip by itself.
    pub(super) fn clips(&self) -> &[SuspectClip] {
        &self.clips
    }

    /// Frames to show of them.
    pub(super) fn into_exhibits(self) -> Vec<Exhibit> {
        choose(self.exhibits)
    }

    fn add(&mut self, clip: SeenClip, num_bits: u32, content: Option<Digest>) -> Result<(), EngineError> {
        let SeenClip { name, features, framings, size_px, integrity, cut, exhibits } = clip;
        let (width, height) = size_px;
        if let Integrity::Damaged { messages } = integrity {
            self.damage.push(format!("{name}: {messages}"));
        }
        self.side_px = self.side_px.min(width).min(height);
        self.frames += features[0].logits.len() / num_bits as usize;
        let readings = features.iter().map(|features| Reading::from_logits(&features.logits, num_bits));
        let readings = readings.collect::<Result<_, _>>()?;
        self.clips.push(SuspectClip { name, readings, framings, size_px, cut, content });
        self.exhibits.push(exhibits);
        for (whole, part) in self.features.iter_mut().zip(&features) {
            whole.extend(part);
        }
        Ok(())
    }
}

impl SuspectClip {
    /// File, folder or view.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// What it says with the guess of that number undone.
    pub(super) fn reading(&self, guess: usize) -> &Reading {
        &self.readings[guess]
    }

    /// How its frames were cut.
    pub(super) fn framings(&self) -> &Framings {
        &self.framings
    }

    /// Width and height of its frames.
    pub(super) fn size_px(&self) -> (u32, u32) {
        self.size_px
    }

    /// Hash of the file, or over those of a folder; none of what is in memory.
    pub(super) fn content(&self) -> Option<Digest> {
        self.content
    }

    /// The part of its frames that was read, if not all.
    pub(super) fn cut(&self) -> Option<Rect> {
        self.cut
    }
}
