//! What a film says of each splat: the difference to the unmarked asset, seen from the film's own cameras, carried back
//! through the transpose of the renderer.
//!
//! For one view and time a picture is A·c + T·background. A copy's colours differ from the original's by its mark, so
//! that Aᵀ(film − original) adds up, for each splat, what all pixels say of its part. No key takes part.

use guard4d_kernels::{Buffer, Device};

use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::media::Frame;
use crate::render::deform::DeformField;
use crate::render::{Frame as FrameOfClip, FrameMut, OffsetBases, Offsets, Prune, Renderer};
use crate::scene::gaussians::CHANNELS;
use crate::scene::{Camera, Model};

/// Largest difference of a pixel that counts, of 1. Marks are smaller, and codecs make mistakes that are larger: the
/// best of those tried on films through H.264.
const LIMIT: f32 = 0.02;
/// Levels of an 8-bit channel that was not cut off.
const BETWEEN: std::ops::RangeInclusive<u8> = 2..=253;
/// Largest final transmittance of a pixel that shows enough of the asset.
const UNCOVERED: f32 = 0.98;

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

/// What a film says of each splat.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatEvidence {
    /// Sum over frames, pixels and channels of the limited difference times the splat's weight.
    pub residual: Vec<f64>,
    /// The same of a difference of 1 everywhere that counts: how much of the film the splat is.
    pub response: Vec<f64>,
}

/// A film's difference to the unmarked asset, channel by channel `[H, W, 4]`, and where it counts.
struct Difference {
    limited: Vec<f32>,
    counted: Vec<f32>,
}

/// Gathers what a film says, frame by frame.
#[derive(Debug)]
pub struct Gatherer {
    device: Device,
    background: [f32; 3],
    field: DeformField,
    renderer: Renderer,
    offsets: Buffer<f32>,
    sums: SplatEvidence,
}

/// Only the DC terms are asked about.
const BASES: OffsetBases = OffsetBases::Dc;

impl Gatherer {
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
            sums: SplatEvidence { residual: vec![0.0; count], response: vec![0.0; count] },
        })
    }

    /// Adds what one frame says.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a camera of another size than its frame; when memory runs out or the device fails.
    pub fn add(&mut self, shot: &Shot<'_>) -> Result<(), EngineError> {
        check_size(shot)?;
        let state = self.field.at(shot.time)?;
        let plan = self.renderer.plan(&state, &shot.camera, Prune::Keep)?;
        let mut pixels = self.device.buffer("film.frame", plan.frame_len())?;
        let mut rec = self.device.recorder()?;
        let clean = FrameMut { clip: &mut pixels, index: 0 };
        self.renderer.forward(&mut rec, &plan, None, self.background, clean)?;
        rec.submit()?;
        let Difference { limited, counted } = difference(shot.frame, &pixels.read()?);
        for (data, sum) in [(&limited, &mut self.sums.residual), (&counted, &mut self.sums.response)] {
            let v_frame = self.device.buffer_from("film.v_frame", data)?;
            let mut rec = self.device.recorder()?;
            let mut v_offsets = rec.zeros("film.v_offsets", self.offsets.len())?;
            let of_plan = Offsets { data: &self.offsets, bases: BASES };
            let frame = FrameOfClip { clip: &v_frame, index: 0 };
            self.renderer.backward(&mut rec, &plan, of_plan, frame, &mut v_offsets)?;
            rec.submit()?;
            for (sum, v) in sum.iter_mut().zip(v_offsets.read()?.chunks_exact(BASES.floats())) {
                *sum += v[..CHANNELS].iter().map(|v| f64::from(*v)).sum::<f64>();
            }
        }
        Ok(())
    }

    /// What all frames said.
    #[must_use]
    pub fn into_evidence(self) -> SplatEvidence {
        self.sums
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

/// Film minus what the unmarked asset looks like there, after the exposure and contrast that fit each channel best.
fn difference(frame: &Frame, clean: &[f32]) -> Difference {
    let mut out = Difference { limited: vec![0.0; clean.len()], counted: vec![0.0; clean.len()] };
    for channel in 0..CHANNELS {
        let pixels = frame.rgb().chunks_exact(CHANNELS).zip(clean.chunks_exact(4)).enumerate();
        let counts = |level: u8, pixel: &[f32]| BETWEEN.contains(&level) && pixel[CHANNELS] <= UNCOVERED;
        let counted =
            pixels.filter(|(_, (levels, pixel))| counts(levels[channel], pixel)).map(|(at, (levels, pixel))| Counted {
                at: 4 * at + channel,
                film: f32::from(levels[channel]) / 255.0,
                clean: pixel[channel],
            });
        let counted: Vec<Counted> = counted.collect();
        let fit = Line::through(&counted);
        for Counted { at, film, clean } in counted {
            out.limited[at] = (film - fit.at(clean)).clamp(-LIMIT, LIMIT);
            out.counted[at] = 1.0;
        }
    }
    out
}

/// A channel of a pixel that counts.
struct Counted {
    /// Its place in `[H, W, 4]`.
    at: usize,
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
    fn through(points: &[Counted]) -> Self {
        let mean = |of: fn(f64, f64) -> f64| {
            points.iter().map(|p| of(p.clean.into(), p.film.into())).sum::<f64>() / points.len().max(1) as f64
        };
        let (x, y) = (mean(|clean, _| clean), mean(|_, film| film));
        let (xx, xy) = (mean(|clean, _| clean * clean) - x * x, mean(|clean, film| clean * film) - x * y);
        if xx <= f64::EPSILON {
            return Self { slope: 1.0, start: 0.0 };
        }
        Self { slope: xy / xx, start: y - xy / xx * x }
    }

    fn at(&self, clean: f32) -> f32 {
        narrow(self.slope * f64::from(clean) + self.start)
    }
}
