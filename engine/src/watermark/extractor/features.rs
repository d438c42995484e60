//! The part of the extractor that has gradients: clip → R (TMSD) → CLIP's normalisation → image tower → features.

use guard4d_kernels::image::normalize::{self, Normalization};
use guard4d_kernels::shape::{Accumulate, ClipShape};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::tmsd::{Tmsd, TmsdPass, TmsdWeights};
use super::weights::CLIP_FRAMES;
use crate::error::EngineError;
use crate::networks::clip::{ClipModel, TowerPurpose, VisionTower, VisionWorkspace};
use crate::watermark::step_part::StepPart;

/// Channel statistics of OpenAI's CLIP (Radford et al. 2021); GuardSplat normalises with the same.
pub(super) const NORMALIZATION: Normalization =
    Normalization { mean: [0.481_454_66, 0.457_827_5, 0.408_210_73], std: [0.268_629_55, 0.261_302_6, 0.275_777_1] };

/// Whether R's weights get gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Training {
    /// R is frozen or absent.
    Frozen,
    /// R is trained.
    Tmsd,
}

/// R and the image tower for `branches` clips of [`CLIP_FRAMES`] frames at once.
#[derive(Debug)]
pub struct FeatureExtractor {
    tower: VisionTower,
    tmsd: Option<Tmsd>,
    passes: Vec<TmsdPass>,
    branches: usize,
    clip_len: usize,
    /// All branches together, and after [`FeatureExtractor::make_room_for_one`] the first one alone.
    batches: Vec<Batch>,
    /// The batch that was read last.
    current: usize,
    /// dL/dx of the first branch `[F,S,S,4]`.
    pub v_x: Buffer<f32>,
}

impl FeatureExtractor {
    /// Towers and buffers.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(
        device: &Device,
        clip: &ClipModel,
        tmsd: Option<&TmsdWeights>,
        branches: usize,
        purpose: TowerPurpose,
    ) -> Result<Self, EngineError> {
        let tower = clip.vision(purpose)?;
        let side = tower.image_size();
        let shape = ClipShape { frames: CLIP_FRAMES, height: side, width: side };
        let tmsd = tmsd.map(|w| Tmsd::new(device, w, shape, clip.precision())).transpose()?;
        let passes = match &tmsd {
            Some(t) => (0..branches).map(|_| t.pass(device)).collect::<Result<_, _>>()?,
            None => Vec::new(),
        };
        let clip_len = shape.pixels() * 4;
        Ok(Self {
            batches: vec![Batch::new(device, &tower, branches, clip_len)?],
            current: 0,
            v_x: device.buffer("extractor.v_x", clip_len)?,
            tower,
            tmsd,
            passes,
            branches,
            clip_len,
        })
    }

    /// Takes the memory to read the first branch without the others, too.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn make_room_for_one(&mut self, device: &Device) -> Result<(), KernelError> {
        if self.batches.iter().all(|batch| batch.branches != 1) {
            self.batches.push(Batch::new(device, &self.tower, 1, self.clip_len)?);
        }
        Ok(())
    }

    /// Gives back the memory of activations that the backward pass can compute again, to the same bits but slower;
    /// whether there were any.
    pub fn forget_activations(&mut self) -> bool {
        self.batches.iter_mut().fold(false, |had, batch| batch.workspace.forget_activations() | had)
    }

    /// Whether the backward pass computes activations again.
    #[must_use]
    pub fn recomputes(&self) -> bool {
        self.batches.iter().any(|batch| batch.workspace.recomputes())
    }

    /// Side of the square that clips are resized to.
    #[must_use]
    pub fn side(&self) -> usize {
        self.tower.image_size()
    }

    /// What clips are resized to.
    #[must_use]
    pub fn shape(&self) -> ClipShape {
        let side = self.side();
        ClipShape { frames: CLIP_FRAMES, height: side, width: side }
    }

    /// Clips that are read at once.
    #[must_use]
    pub fn branches(&self) -> usize {
        self.branches
    }

    /// Floats of a resized clip.
    #[must_use]
    pub fn clip_len(&self) -> usize {
        self.clip_len
    }

    /// R, when there is one.
    pub fn tmsd(&mut self) -> Option<&mut Tmsd> {
        self.tmsd.as_mut()
    }

    /// Features of unit length `[B·F, D]` of the branches that [`FeatureExtractor::forward`] read last.
    #[must_use]
    pub fn features(&self) -> &Buffer<f32> {
        &self.batches[self.current].workspace.features
    }

    /// Features of one resized clip per branch; B is the number of branches or, with room for it, 1.
    ///
    /// # Shapes
    /// in `clips` B × \[F,S,S,4\] in \[0, 1\], fourth channel 0 · out [`FeatureExtractor::features`] (=)
    /// # Equation: Guard4D Eq. 8
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn forward(&mut self, rec: &mut Recorder, clips: &[&Buffer<f32>]) -> Result<(), KernelError> {
        self.stack(rec, clips)?;
        self.read(rec)
    }

    /// The first half of [`FeatureExtractor::forward`]: R of every clip.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn stack(&mut self, rec: &mut Recorder, clips: &[&Buffer<f32>]) -> Result<(), KernelError> {
        let len = self.clip_len;
        let fits = self.batches.iter().position(|batch| batch.branches == clips.len());
        self.current = fits.ok_or_else(|| KernelError::Shape {
            kernel: "watermark/extractor",
            buffer: "clips",
            got: clips.len().to_string(),
            expected: format!("{}, or 1 with room for it", self.branches),
        })?;
        let Self { batches, current, tmsd, passes, .. } = self;
        let batch = &mut batches[*current];
        StepPart::Tmsd.record(rec, |rec| {
            for (i, clip) in clips.iter().enumerate() {
                match tmsd {
                    Some(tmsd) => {
                        tmsd.forward(rec, clip, &mut passes[i])?;
                        rec.copy(&passes[i].out, 0, &mut batch.stacked, i * len, len)?;
                    }
                    None => rec.copy(clip, 0, &mut batch.stacked, i * len, len)?,
                }
            }
            Ok(())
        })
    }

    /// The second half: features of what was stacked last. For as many clips it records the same passes on the same
    /// buffers each time, and so does [`FeatureExtractor::backward`], until activations are forgotten.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn read(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        let batch = &mut self.batches[self.current];
        StepPart::Image
            .record(rec, |rec| normalize::forward(rec, &NORMALIZATION, &batch.stacked, &mut batch.pixels))?;
        StepPart::Clip.record(rec, |rec| self.tower.forward(rec, &batch.pixels, &mut batch.workspace))
    }

    /// Gradient to the first branch's clip, in `self.v_x`; with `train` also to R's weights, over the branches that
    /// were read last.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn backward(
        &mut self,
        rec: &mut Recorder,
        v_features: &Buffer<f32>,
        train: Training,
    ) -> Result<(), KernelError> {
        let len = self.clip_len;
        let Self { batches, current, tower, tmsd, passes, v_x, .. } = self;
        let batch = &mut batches[*current];
        StepPart::Clip.record(rec, |rec| tower.backward(rec, v_features, &mut batch.workspace, &mut batch.pixels))?;
        StepPart::Image
            .record(rec, |rec| normalize::backward(rec, &NORMALIZATION, &batch.pixels, &mut batch.v_stacked))?;
        StepPart::Tmsd.record(rec, |rec| {
            let Some(tmsd) = tmsd else { return rec.copy(&batch.v_stacked, 0, v_x, 0, len) };
            for (i, pass) in passes.iter_mut().enumerate().take(batch.branches) {
                let weights = match train {
                    Training::Frozen if i > 0 => continue,
                    Training::Frozen => None,
                    Training::Tmsd if i == 0 => Some(Accumulate::Overwrite),
                    Training::Tmsd => Some(Accumulate::Add),
                };
                rec.copy(&batch.v_stacked, i * len, &mut pass.v_out, 0, len)?;
                tmsd.backward(rec, pass, weights)?;
            }
            rec.copy(&passes[0].v_x, 0, v_x, 0, len)
        })
    }
}

/// What the tower reads at once, and its working memory.
#[derive(Debug)]
struct Batch {
    branches: usize,
    /// R's output of these branches `[B·F,S,S,4]`.
    stacked: Buffer<f32>,
    pixels: Buffer<f32>,
    v_stacked: Buffer<f32>,
    workspace: VisionWorkspace,
}

impl Batch {
    fn new(device: &Device, tower: &VisionTower, branches: usize, clip_len: usize) -> Result<Self, KernelError> {
        let all = |name: &str| device.buffer(&format!("extractor.{name}"), branches * clip_len);
        Ok(Self {
            branches,
            workspace: tower.workspace(branches * CLIP_FRAMES)?,
            stacked: all("stacked")?,
            pixels: all("pixels")?,
            v_stacked: all("v_stacked")?,
        })
    }
}
