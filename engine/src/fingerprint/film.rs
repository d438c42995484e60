//! What a film says of each splat: the difference to the unmarked asset, seen from the film's own cameras, carried back
//! through the transpose of the renderer.
//!
//! For one view and time a picture is A·c + T·background. A copy's colours differ from the original's by its mark, so
//! that Aᵀ(film − original) adds up, for each splat, what all pixels say of its part. No key takes part.

use guard4d_kernels::{Buffer, Device};

use super::lowpass::{Pictures, as_kept};
use super::seen::{Seen, SplatEvidence};
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::media::Frame;
use crate::render::deform::DeformField;
use crate::render::{Frame as FrameOfClip, FrameMut, FramePlan, OffsetBases, Offsets, Prune, Renderer};
use crate::scene::gaussians::{CHANNELS, Y0};
use crate::scene::{Camera, FrameSize, Model};

/// Largest difference of a pixel that counts, of 1. Marks are smaller, and codecs make mistakes that are larger: the
/// best of those tried on films through H.264.
const LIMIT: f32 = 0.02;
/// Levels of an 8-bit channel that was not cut off.
const BETWEEN: std::ops::RangeInclusive<u8> = 2..=253;
/// Largest final transmittance of a pixel that shows enough of the asset.
const UNCOVERED: f32 = 0.98;
/// Weights of red, green and blue in the luma of ITU-R BT.601. A mark moves all three alike, and codecs keep what else
/// there is at half the size or worse.
const LUMA: [f32; CHANNELS] = [0.299, 0.587, 0.114];
/// Pixels whose errors go together: those of a codec's block of 8x8. The best of 1, 4, 16, 32, 64, 128 and 512 on films
/// through H.264; without a codec none of them is much worse than 1.
const TOGETHER: f64 = 64.0;
/// Only the DC terms are asked about.
const BASES: OffsetBases = OffsetBases::Dc;
/// A difference is taken between pictures; small enough that no colour is cut off at 0, large enough for 32-bit floats.
const PROBE: f64 = 0.02;

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

/// How finely a film was drawn before it became what it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// At the size that it has.
    AsLarge,
    /// At twice the size, and made smaller: splats are drawn no narrower than a pixel.
    Twice,
}

impl Detail {
    /// Both, the likelier one first.
    pub const ALL: [Self; 2] = [Self::AsLarge, Self::Twice];

    /// Pixels that became one, along a side.
    const fn side(self) -> u32 {
        match self {
            Self::AsLarge => 1,
            Self::Twice => 2,
        }
    }
}

/// A frame as it is kept: what draws it again, and where it counts.
#[derive(Debug)]
struct Exposure {
    plan: FramePlan,
    detail: Detail,
    /// Red of the unmarked asset at each pixel.
    clean: Vec<f32>,
    /// Whether a pixel counts.
    counted: Vec<bool>,
}

/// Frames of films of one asset, and what they say of it.
#[derive(Debug)]
pub struct Exposures {
    device: Device,
    background: [f32; 3],
    field: DeformField,
    renderer: Renderer,
    offsets: Buffer<f32>,
    exposures: Vec<Exposure>,
    sums: SplatEvidence,
}

impl Exposures {
    /// Of films of `model`, the unmarked asset.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn new(device: &Device, model: &Model) -> Result<Self, EngineError> {
        let count = model.gaussians.len();
        Ok(Self {
            device: device.clone(),
            background: model.background,
            field: DeformField::new(device, &model.gaussians, &model.motion)?,
            renderer: Renderer::new(device)?,
            offsets: device.buffer("film.offsets", count * BASES.floats())?,
            exposures: Vec::new(),
            sums: SplatEvidence::none(count),
        })
    }

    /// Adds what one frame says.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a camera of another size than its frame; when memory runs out or the device fails.
    pub fn add(&mut self, shot: &Shot<'_>, detail: Detail) -> Result<(), EngineError> {
        let plan = self.plan(shot, detail)?;
        let clean = draw(&self.device, &mut self.renderer, &Drawn { plan: &plan, detail }, None, self.background)?;
        let Difference { limited, counted } = difference(shot.frame, &clean);
        // One way back for both: residual in the first channel, where it counts in the second.
        let mut v_frame = vec![0.0; clean.len()];
        for ((v, limited), counted) in v_frame.chunks_exact_mut(4).zip(&limited).zip(&counted) {
            (v[0], v[1]) = (*limited, if *counted { 1.0 } else { 0.0 });
            self.sums.samples += u64::from(*counted);
            self.sums.squares += f64::from(*limited).powi(2);
        }
        let v_frame = spread(v_frame, &plan, detail);
        let v_frame = self.device.buffer_from("film.v_frame", &v_frame)?;
        let mut rec = self.device.recorder()?;
        let mut v_offsets = rec.zeros("film.v_offsets", self.offsets.len())?;
        self.back(&mut rec, &plan, &v_frame, &mut v_offsets)?;
        rec.submit()?;
        let rows = v_offsets.read()?;
        let sums = self.sums.residual.iter_mut().zip(&mut self.sums.response);
        for ((residual, response), v) in sums.zip(rows.chunks_exact(BASES.floats())) {
            // In colours: a DC term moves one by Y0.
            *residual += f64::from(v[0]) / Y0;
            *response += f64::from(v[1]) / Y0;
        }
        let clean = clean.chunks_exact(4).map(|pixel| pixel[0]).collect();
        self.exposures.push(Exposure { plan, detail, clean, counted });
        Ok(())
    }

    /// Adds a frame of a film of which it is not yet known how finely it was drawn, or is since an earlier frame.
    ///
    /// # Errors
    /// As [`add`](Self::add).
    pub fn add_of_film(&mut self, shot: &Shot<'_>, known: &mut Option<Detail>) -> Result<(), EngineError> {
        let detail = match *known {
            Some(detail) => detail,
            None => *known.insert(self.detail_of(shot)?),
        };
        self.add(shot, detail)
    }

    /// How finely a film was drawn that this is a frame of: as it is least different from the unmarked asset.
    ///
    /// # Errors
    /// As [`add`](Self::add).
    fn detail_of(&mut self, shot: &Shot<'_>) -> Result<Detail, EngineError> {
        let mut best = (Detail::AsLarge, f64::INFINITY);
        for detail in Detail::ALL {
            let plan = self.plan(shot, detail)?;
            let clean = draw(&self.device, &mut self.renderer, &Drawn { plan: &plan, detail }, None, self.background)?;
            let squares = difference(shot.frame, &clean).limited.iter().map(|r| f64::from(*r).powi(2)).sum();
            if squares < best.1 {
                best = (detail, squares);
            }
        }
        Ok(best.0)
    }

    fn plan(&mut self, shot: &Shot<'_>, detail: Detail) -> Result<FramePlan, EngineError> {
        check_size(shot)?;
        let side = detail.side();
        let size = FrameSize::new(shot.camera.width * side, shot.camera.height * side)?;
        let state = self.field.at(shot.time)?;
        let plan = self.renderer.plan(&state, &shot.camera.resized(size), Prune::Keep)?;
        self.renderer.fix_view(plan)
    }

    /// Pixels of the frames that are kept.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.exposures.iter().map(|exposure| exposure.clean.len()).sum()
    }

    /// Forgets all frames.
    pub fn clear(&mut self) {
        self.exposures.clear();
        self.sums = SplatEvidence::none(self.sums.residual.len());
    }

    fn back(
        &mut self,
        rec: &mut guard4d_kernels::Recorder,
        plan: &FramePlan,
        v_frame: &Buffer<f32>,
        v_offsets: &mut Buffer<f32>,
    ) -> Result<(), EngineError> {
        let of_plan = Offsets { data: &self.offsets, bases: BASES };
        self.renderer.backward(rec, plan, of_plan, FrameOfClip { clip: v_frame, index: 0 }, v_offsets)
    }
}

/// A plan, and how many of its pixels become one.
struct Drawn<'a> {
    plan: &'a FramePlan,
    detail: Detail,
}

/// A picture `[H, W, 4]` of the asset with offsets of its DC terms.
fn draw(
    device: &Device,
    renderer: &mut Renderer,
    drawn: &Drawn<'_>,
    offsets: Option<&Buffer<f32>>,
    background: [f32; 3],
) -> Result<Vec<f32>, EngineError> {
    let plan = drawn.plan;
    let mut pixels = device.buffer("film.frame", plan.frame_len())?;
    let mut rec = device.recorder()?;
    let offsets = offsets.map(|data| Offsets { data, bases: BASES });
    renderer.forward(&mut rec, plan, offsets, background, FrameMut { clip: &mut pixels, index: 0 })?;
    rec.submit()?;
    Ok(made_smaller(pixels.read()?, plan, drawn.detail))
}

/// Means of the pixels `[H, W, 4]` that become one.
fn made_smaller(pixels: Vec<f32>, plan: &FramePlan, detail: Detail) -> Vec<f32> {
    let (side, width) = (detail.side() as usize, plan.width() as usize);
    if side == 1 {
        return pixels;
    }
    let mut small = vec![0.0; pixels.len() / (side * side)];
    for (at, pixel) in pixels.chunks_exact(4).enumerate() {
        let to = (at / width / side) * (width / side) + at % width / side;
        small[4 * to..4 * to + 4].iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value / (side * side) as f32);
    }
    small
}

/// The transpose of [`made_smaller`].
fn spread(small: Vec<f32>, plan: &FramePlan, detail: Detail) -> Vec<f32> {
    let (side, width) = (detail.side() as usize, plan.width() as usize);
    if side == 1 {
        return small;
    }
    let mut pixels = vec![0.0; small.len() * side * side];
    for (at, pixel) in pixels.chunks_exact_mut(4).enumerate() {
        let from = (at / width / side) * (width / side) + at % width / side;
        pixel.iter_mut().zip(&small[4 * from..]).for_each(|(value, sum)| *value = sum / (side * side) as f32);
    }
    pixels
}

impl Seen for Exposures {
    fn evidence(&self) -> &SplatEvidence {
        &self.sums
    }

    fn together(&self) -> f64 {
        TOGETHER
    }

    /// # Equation
    /// Aᵀ W A of the colours, by the difference of two pictures and the transpose.
    fn normal(&mut self, colours: &[f64]) -> Result<Vec<f64>, EngineError> {
        let largest = colours.iter().fold(0.0f64, |most, colour| most.max(colour.abs()));
        if largest <= 0.0 {
            return Ok(vec![0.0; colours.len()]);
        }
        let scale = PROBE / largest;
        let mut rows = vec![0.0f32; self.offsets.len()];
        for (row, colour) in rows.chunks_exact_mut(BASES.floats()).zip(colours) {
            row[0] = narrow(scale * colour / Y0);
        }
        let moved = self.device.buffer_from("film.moved", &rows)?;
        let mut rec = self.device.recorder()?;
        let mut v_offsets = rec.zeros("film.v_offsets", self.offsets.len())?;
        rec.submit()?;
        let exposures = std::mem::take(&mut self.exposures);
        for Exposure { plan, detail, clean, counted } in &exposures {
            let drawn = Drawn { plan, detail: *detail };
            let mut pixels = draw(&self.device, &mut self.renderer, &drawn, Some(&moved), self.background)?;
            for ((pixel, clean), counted) in pixels.chunks_exact_mut(4).zip(clean).zip(counted) {
                let difference = if *counted { pixel[0] - clean } else { 0.0 };
                pixel.copy_from_slice(&[difference, 0.0, 0.0, 0.0]);
            }
            let v_frame = self.device.buffer_from("film.v_frame", &spread(pixels, plan, *detail))?;
            let mut rec = self.device.recorder()?;
            self.back(&mut rec, plan, &v_frame, &mut v_offsets)?;
            rec.submit()?;
        }
        self.exposures = exposures;
        let rows = v_offsets.read()?;
        Ok(rows.chunks_exact(BASES.floats()).map(|v| f64::from(v[0]) / (Y0 * scale)).collect())
    }
}

fn check_size(shot: &Shot<'_>) -> Result<(), EngineError> {
    let (frame, camera) = (shot.frame, &shot.camera);
    if [frame.width(), frame.height()] == [camera.width, camera.height] {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "camera of a frame".to_owned(),
        got: format!("{}x{} pixels", camera.width, camera.height),
        expected: format!("{}x{}, as the frame has", frame.width(), frame.height()),
    })
}

/// A film's difference to the unmarked asset in luma, pixel by pixel, and where it counts.
struct Difference {
    limited: Vec<f32>,
    counted: Vec<bool>,
}

/// Film minus what the unmarked asset looks like there, after the exposure and contrast that fit each channel best.
fn difference(frame: &Frame, clean: &[f32]) -> Difference {
    let pixels = frame.rgb().chunks_exact(CHANNELS).zip(clean.chunks_exact(4));
    let counts = |(levels, pixel): (&[u8], &[f32])| {
        levels.iter().all(|level| BETWEEN.contains(level)) && pixel[CHANNELS] <= UNCOVERED
    };
    let counted: Vec<bool> = pixels.clone().map(counts).collect();
    let mut pictures = vec![[0.0f32; 2]; counted.len()];
    for (channel, weight) in LUMA.into_iter().enumerate() {
        let levels = pixels
            .clone()
            .map(|(levels, pixel)| Level { film: f32::from(levels[channel]) / 255.0, clean: pixel[channel] });
        let fit = Line::through(levels.clone().zip(&counted).filter(|(_, counted)| **counted).map(|(level, _)| level));
        for ([film, clean], level) in pictures.iter_mut().zip(levels) {
            *film += weight * level.film;
            *clean += weight * fit.at(level.clean);
        }
    }
    // What does not count is as the clean picture, so that no edge of it is taken for detail.
    let (film, clean): (Vec<f32>, Vec<f32>) = pictures
        .iter()
        .zip(&counted)
        .map(|([film, clean], counted)| (if *counted { *film } else { *clean }, *clean))
        .unzip();
    let width = frame.width() as usize;
    let kept = as_kept(&Pictures { film: &film, clean: &clean, counted: &counted, width });
    let limited = film
        .iter()
        .zip(kept)
        .zip(&counted)
        .map(|((film, kept), counted)| if *counted { (film - kept).clamp(-LIMIT, LIMIT) } else { 0.0 })
        .collect();
    Difference { limited, counted }
}

/// A channel of a pixel.
#[derive(Clone, Copy)]
struct Level {
    film: f32,
    clean: f32,
}

/// film ≈ slope·clean + start
struct Line {
    slope: f64,
    start: f64,
}

impl Line {
    /// The least squares; film = clean where that does not vary.
    fn through(levels: impl Iterator<Item = Level>) -> Self {
        let (mut n, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for Level { film, clean } in levels {
            let (film, clean) = (f64::from(film), f64::from(clean));
            n += 1.0;
            x += clean;
            y += film;
            xx += clean * clean;
            xy += clean * film;
        }
        let n = f64::max(n, 1.0);
        let (x, y) = (x / n, y / n);
        let (xx, xy) = (xx / n - x * x, xy / n - x * y);
        if xx <= f64::EPSILON {
            return Self { slope: 1.0, start: 0.0 };
        }
        Self { slope: xy / xx, start: y - xy / xx * x }
    }

    fn at(&self, clean: f32) -> f32 {
        narrow(self.slope * f64::from(clean) + self.start)
    }
}
