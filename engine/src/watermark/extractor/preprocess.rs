//! Brings 8-bit frames to the size that CLIP sees, and undoes what may have been done to them on the way.

use guard4d_kernels::image::resize::{ImageSize, Region, ResizePlan};
use guard4d_kernels::image::warp::{Sampling, Warp};
use guard4d_kernels::image::{CHANNELS, colour_map, quantize, warp};
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device, Recorder};

use crate::error::EngineError;
use crate::media::Frame;
use crate::picture::distortion::Resizer;
use crate::picture::foreground::{border_colour, without_corners};
use crate::picture::part::{Part, Window};
use crate::picture::undo_guess::UndoGuess;

/// Sides of the pictures on which guesses are undone and turned films put upright, at most, in sides of CLIP's: more
/// than CLIP will see, so that sampling twice blurs nothing of it, and as little for a video of any size.
const WORKING_SIDES: usize = 4;

/// Frames of one clip on their way to CLIP, as many at once as the extractor sees together.
#[derive(Debug)]
pub struct Preprocessor {
    device: Device,
    size: ImageSize,
    /// What CLIP sees.
    seen: ClipShape,
    /// Frames as they are `[F,H,W,4]`.
    full: Buffer<f32>,
    /// What of each is shown, or of all; turned alike.
    windows: Vec<Window>,
    cut: Resizer,
    /// Colour of the border of the first frame.
    border: [f32; 3],
    /// For guesses and turns; made with the first.
    undoing: Option<Undoing>,
}

impl Preprocessor {
    /// Room for frames of the size of `first`, which CLIP sees as clips of shape `seen`.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, first: &Frame, seen: ClipShape) -> Result<Self, EngineError> {
        let size = ImageSize { height: first.height() as usize, width: first.width() as usize };
        let plan = ResizePlan::new(device, size, size_of(seen))?;
        Ok(Self {
            device: device.clone(),
            windows: vec![Window::whole(size)],
            cut: Resizer::new(device, seen.frames, plan)?,
            full: device.buffer("preprocessor.full", seen.frames * size.height * size.width * CHANNELS)?,
            border: border_colour(&without_corners(first)).map(|level| f32::from(level) / 255.0),
            undoing: None,
            size,
            seen,
        })
    }

    /// Takes a clip from at most as many frames, the last repeated. What was recorded before has to be submitted.
    ///
    /// # Errors
    /// [`EngineError::Usage`] with frames of another size; when the device fails.
    pub fn load(&mut self, frames: &[Frame]) -> Result<(), EngineError> {
        let ImageSize { height, width } = self.size;
        for i in 0..self.seen.frames {
            let frame = &frames[i.min(frames.len() - 1)];
            if (frame.height() as usize, frame.width() as usize) != (height, width) {
                return Err(EngineError::Usage {
                    what: "clip".to_owned(),
                    got: format!("a frame of {} x {} px", frame.width(), frame.height()),
                    expected: format!("{width} x {height} px like the first"),
                });
            }
            self.full.write_at(i * height * width * CHANNELS, &frame.to_rgba32f())?;
        }
        if let Some(undoing) = &mut self.undoing {
            undoing.is_current = false;
        }
        Ok(())
    }

    /// Shows these parts of the frames from now on, of one that is not told of the last. Frames that are seen together
    /// are turned alike, as the median of them says.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn cut(&mut self, parts: &[Part]) -> Result<(), EngineError> {
        let window = |i: usize| parts.get(i).or(parts.last()).unwrap_or(&Part::All).window(self.size);
        let mut windows: Vec<Window> = (0..self.seen.frames).map(window).collect();
        let mut turns: Vec<f64> = windows.iter().map(|window| window.turn_deg).collect();
        let middle = turns.len() / 2;
        let turn_deg = *turns.select_nth_unstable_by(middle, f64::total_cmp).1;
        windows.iter_mut().for_each(|window| window.turn_deg = turn_deg);
        if windows.iter().all(|window| *window == windows[0]) {
            windows.truncate(1);
        }
        if windows != self.windows {
            self.windows = windows;
            let regions = regions_of(&self.windows);
            self.cut.replace(ResizePlan::regions(&self.device, self.size, size_of(self.seen), &regions)?);
            if let Some(undoing) = &mut self.undoing {
                undoing.cut(&self.device, self.size, &regions)?;
            }
        }
        Ok(())
    }

    /// The clip as CLIP sees it with `guess` undone, in `resized` `[F,S,S,4]`.
    ///
    /// # Errors
    /// When the device fails.
    pub fn show(&mut self, rec: &mut Recorder, guess: UndoGuess, resized: &mut Buffer<f32>) -> Result<(), EngineError> {
        let window = self.windows[0];
        if guess == UndoGuess::NONE && window.turn_deg == 0.0 {
            return Ok(self.cut.forward(rec, &self.full, resized)?);
        }
        let undoing = match &mut self.undoing {
            Some(undoing) => undoing,
            None => {
                let mut undoing = Undoing::new(&self.device, self.size, self.seen)?;
                undoing.cut(&self.device, self.size, &regions_of(&self.windows))?;
                self.undoing.insert(undoing)
            }
        };
        undoing.show(rec, Edit { window, guess, border: self.border }, &self.full, resized)
    }
}

fn regions_of(windows: &[Window]) -> Vec<Region> {
    windows.iter().map(|window| window.region()).collect()
}

/// What a clip is freed of.
#[derive(Clone, Copy)]
struct Edit {
    /// The turn of what is shown; windows of one clip have one shape and one turn.
    window: Window,
    guess: UndoGuess,
    /// Colour of what lies outside of the frames.
    border: [f32; 3],
}

impl Edit {
    /// Puts the picture upright, and back where it was.
    fn warp(self, clip: ClipShape) -> Warp {
        let sides = [clip.width, clip.height].map(|n| n as f64);
        let mut map = self.window.in_region();
        for (row, side) in map.iter_mut().zip(sides) {
            row.iter_mut().zip(sides).for_each(|(v, across)| *v *= side / across);
        }
        let upright = Warp::about_the_middle(clip, map, Sampling::Bilinear, self.border);
        self.guess.warp_back(clip, self.border).of(&upright)
    }
}

/// Undoes guesses on pictures that are not much larger than CLIP's.
#[derive(Debug)]
struct Undoing {
    clip: ClipShape,
    shrink: Resizer,
    resize: Resizer,
    /// The clip that was loaded last, at the working size.
    edited: Buffer<f32>,
    is_current: bool,
    placed: Buffer<f32>,
    restored: Buffer<f32>,
}

impl Undoing {
    fn new(device: &Device, size: ImageSize, seen: ClipShape) -> Result<Self, EngineError> {
        let longest = size.height.max(size.width);
        let most = longest.min(WORKING_SIDES * seen.height.max(seen.width));
        let part = |n: usize| (n * most).div_ceil(longest);
        let working = ImageSize { height: part(size.height), width: part(size.width) };
        let clip = ClipShape { height: working.height, width: working.width, ..seen };
        let resizer = |from, to| Resizer::new(device, seen.frames, ResizePlan::new(device, from, to)?);
        let buffer = |name: &str| device.buffer(&format!("preprocessor.{name}"), clip.pixels() * CHANNELS);
        Ok(Self {
            clip,
            shrink: resizer(size, working)?,
            resize: resizer(working, size_of(seen))?,
            edited: buffer("edited")?,
            is_current: false,
            placed: buffer("placed")?,
            restored: buffer("restored")?,
        })
    }

    /// Undoes guesses on these regions of frames of this size.
    fn cut(&mut self, device: &Device, size: ImageSize, regions: &[Region]) -> Result<(), EngineError> {
        self.is_current = false;
        self.shrink.replace(ResizePlan::regions(device, size, size_of(self.clip), regions)?);
        Ok(())
    }

    fn show(
        &mut self,
        rec: &mut Recorder,
        edit: Edit,
        full: &Buffer<f32>,
        resized: &mut Buffer<f32>,
    ) -> Result<(), EngineError> {
        if !self.is_current {
            self.shrink.forward(rec, full, &mut self.edited)?;
            self.is_current = true;
        }
        warp::forward(rec, self.clip, &edit.warp(self.clip), &self.edited, &mut self.placed)?;
        colour_map::forward(rec, &edit.guess.colours_back(), &self.placed, &mut self.restored)?;
        // What leaked had 8 bits, and no colour beyond white.
        quantize::forward(rec, &self.restored, &mut self.placed)?;
        Ok(self.resize.forward(rec, &self.placed, resized)?)
    }
}

fn size_of(clip: ClipShape) -> ImageSize {
    ImageSize { height: clip.height, width: clip.width }
}
