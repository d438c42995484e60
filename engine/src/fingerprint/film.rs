//! What a film says of each splat: the difference to the unmarked asset, seen from the film's own cameras, carried back
//! through the transpose of the renderer.
//!
//! For one view and time a picture is A·c + T·background. A copy's colours differ from the original's by its mark, so
//! that Aᵀ(film − original) adds up, for each splat, what all pixels say of its part. No key takes part.

use guard4d_kernels::{Buffer, Device};

use super::drawing::{BASES, Drawn, Look};
use super::residual::{Difference, difference};
use super::seen::{Seen, SplatEvidence};
use super::shot::Shot;
use super::studio::{Studio, Taken};
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::Model;
use crate::scene::gaussians::Y0;

/// Pixels whose errors go together: those of a codec's block of 8x8. The best of 1, 4, 16, 32, 64, 128 and 512 on films
/// through H.264; without a codec none of them is much worse than 1.
const TOGETHER: f64 = 64.0;
/// A difference is taken between pictures; small enough that no colour is cut off at 0, large enough for 32-bit floats.
const PROBE: f64 = 0.02;

/// A frame as it is kept: what draws it again, and where it counts.
#[derive(Debug)]
struct Exposure {
    drawn: Drawn,
    /// Red of the unmarked asset at each pixel, as if no framebuffer rounded it.
    clean: Vec<f32>,
    /// Whether a pixel counts.
    counted: Vec<bool>,
}

/// Frames of films of one asset, and what they say of it.
#[derive(Debug)]
pub struct Exposures {
    device: Device,
    studio: Studio,
    offsets: Buffer<f32>,
    exposures: Vec<Exposure>,
    sums: SplatEvidence,
}

impl Exposures {
    /// Of films of an asset with so many splats.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn new(device: &Device, splats: usize) -> Result<Self, EngineError> {
        Ok(Self {
            device: device.clone(),
            studio: Studio::new(device),
            offsets: device.buffer("film.offsets", splats * BASES.floats())?,
            exposures: Vec::new(),
            sums: SplatEvidence::none(splats),
        })
    }

    /// Adds what one frame says of `model`, the unmarked asset.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a camera of another size than its frame; when memory runs out or the device fails.
    pub fn add(&mut self, model: &Model, shot: &Shot<'_>, look: Look) -> Result<(), EngineError> {
        let taken = self.studio.take(model, shot, look)?;
        self.add_taken(shot, taken)
    }

    fn add_taken(&mut self, shot: &Shot<'_>, Taken { drawn, clean }: Taken) -> Result<(), EngineError> {
        let Difference { limited, counted } = difference(shot.frame, &clean);
        // One way back for both: residual in the first channel, where it counts in the second.
        let mut v_picture = vec![0.0; clean.len()];
        for ((v, limited), counted) in v_picture.chunks_exact_mut(4).zip(&limited).zip(&counted) {
            (v[0], v[1]) = (*limited, if *counted { 1.0 } else { 0.0 });
            self.sums.samples += u64::from(*counted);
            self.sums.squares += f64::from(*limited).powi(2);
        }
        let mut v_offsets = self.no_offsets()?;
        let painter = self.studio.painter(drawn.look.making.settings);
        painter.back(&drawn, &self.offsets, v_picture, &mut v_offsets)?;
        let rows = v_offsets.read()?;
        let sums = self.sums.residual.iter_mut().zip(&mut self.sums.response);
        for ((residual, response), v) in sums.zip(rows.chunks_exact(BASES.floats())) {
            // In colours: a DC term moves one by Y0.
            *residual += f64::from(v[0]) / Y0;
            *response += f64::from(v[1]) / Y0;
        }
        // What others are compared with that nothing is rounded in either.
        let linear = if painter.rounds() { painter.draw_linear(&drawn, &self.offsets)? } else { clean };
        let clean = linear.chunks_exact(4).map(|pixel| pixel[0]).collect();
        self.exposures.push(Exposure { drawn, clean, counted });
        Ok(())
    }

    /// Adds a frame of a film of which it is not yet known how it was drawn, or is since an earlier frame.
    ///
    /// # Errors
    /// As [`add`](Self::add).
    pub fn add_of_film(&mut self, model: &Model, shot: &Shot<'_>, known: &mut Option<Look>) -> Result<(), EngineError> {
        let taken = self.studio.take_of_film(model, shot, known)?;
        self.add_taken(shot, taken)
    }

    fn no_offsets(&self) -> Result<Buffer<f32>, EngineError> {
        let mut rec = self.device.recorder()?;
        let none = rec.zeros("film.v_offsets", self.offsets.len())?;
        rec.submit()?;
        Ok(none)
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
        let mut v_offsets = self.no_offsets()?;
        for Exposure { drawn, clean, counted } in &self.exposures {
            let painter = self.studio.painter(drawn.look.making.settings);
            let mut pixels = painter.draw_linear(drawn, &moved)?;
            for ((pixel, clean), counted) in pixels.chunks_exact_mut(4).zip(clean).zip(counted) {
                let difference = if *counted { pixel[0] - clean } else { 0.0 };
                pixel.copy_from_slice(&[difference, 0.0, 0.0, 0.0]);
            }
            painter.back(drawn, &self.offsets, pixels, &mut v_offsets)?;
        }
        let rows = v_offsets.read()?;
        Ok(rows.chunks_exact(BASES.floats()).map(|v| f64::from(v[0]) / (Y0 * scale)).collect())
    }
}
