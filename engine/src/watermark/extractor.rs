//! The private extractor: clip → R (TMSD) → CLIP image tower → calibration → decoder → logits.

use std::path::Path;

use guard4d_kernels::image::normalize::{self, Normalization};
use guard4d_kernels::shape::{Accumulate, ClipShape};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::calibration::Calibration;
use super::decoder::{Decoder, DecoderPass};
use super::digest::Digest;
use super::edits::Edit;
use super::evidence::ExtractorMode;
use super::intake::Intake;
use super::key::{Key, digest_of};
use super::mixing::Mixing;
use super::tmsd::{Tmsd, TmsdPass, TmsdWeights};
use crate::clip::{Clip, Purpose, VisionTower, VisionWorkspace};
use crate::error::EngineError;
use crate::media::Frame;
use crate::output::{AtomicFile, Existing};
use crate::tensor_file::TensorFile;

/// `format` entry of an extractor file.
const FORMAT: &str = "guard4d.extractor/1";
/// Frames that the extractor sees at once (Guard4D Sec. 4: clips of eight frames).
pub const CLIP_FRAMES: usize = 8;
/// Channel statistics of OpenAI's CLIP (Radford et al. 2021); GuardSplat normalises with the same.
const NORMALIZATION: Normalization =
    Normalization { mean: [0.481_454_66, 0.457_827_5, 0.408_210_73], std: [0.268_629_55, 0.261_302_6, 0.275_777_1] };
/// What happens to a frame before R, for receipts.
pub const PREPROCESS: &str = "resize: bilinear, antialiased, align_corners; squashed to CLIP's size; rgb in [0, 1]";

/// Most frames of one film that [`Watching`] takes, each counted as often as edits are undone: twelve hours at 24 in a second, of
/// which the features take 2 GiB at CLIP's 512 numbers a frame.
pub const MAX_FRAMES: usize = 1 << 20;

/// The parts of an extractor that belong to one asset; private.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtractorWeights {
    /// How R was made.
    pub mode: ExtractorMode,
    /// R; `None` is the identity.
    pub tmsd: Option<TmsdWeights>,
    /// Map between image and text features.
    pub calibration: Calibration,
    /// Rotation that mixes the calibration's directions; its number is all that an extractor that is blind to the message can have of it.
    pub mixing: Mixing,
}

impl ExtractorWeights {
    fn file(&self, key: &Key) -> TensorFile {
        let mut file = TensorFile::default();
        let mode = serde_json::to_value(self.mode).ok().and_then(|v| v.as_str().map(str::to_owned));
        file.meta.insert("format".to_owned(), FORMAT.to_owned());
        file.meta.insert("mode".to_owned(), mode.expect("modes serialise as words"));
        file.meta.insert("key_id".to_owned(), key.prf().key_id().to_string());
        file.meta.insert("clip".to_owned(), key.clip.to_string());
        self.mixing.store(&mut file);
        self.calibration.store(&mut file, key.bits());
        if let Some(tmsd) = &self.tmsd {
            tmsd.store(&mut file);
        }
        file
    }

    /// Hash of the file that [`ExtractorWeights::write`] writes.
    ///
    /// # Errors
    /// When a tensor's shape does not fit its values.
    pub fn digest(&self, key: &Key) -> Result<Digest, EngineError> {
        Ok(Digest::of(&self.file(key).to_bytes()?))
    }

    /// Writes the extractor, whole or not at all.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] or [`EngineError::Io`] naming the file.
    pub fn write(&self, path: &Path, key: &Key, existing: Existing) -> Result<(), EngineError> {
        AtomicFile::write(path, existing, &self.file(key).to_bytes()?)
    }

    /// Reads an extractor that belongs to `key`. A file that calls itself blind to the message is refused if its R does
    /// what only a trained network does: it may have been trained to say the message.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming what does not fit.
    pub fn read(path: &Path, key: &Key) -> Result<Self, EngineError> {
        let file = TensorFile::read(path)?;
        file.expect_text("format", FORMAT)?;
        file.expect_text("key_id", &key.prf().key_id().to_string())?;
        file.expect_text("clip", &key.clip.to_string())?;
        let word = file.text("mode")?;
        let mode = serde_json::from_value(word.into()).map_err(|e| EngineError::BadData {
            path: path.to_owned(),
            field: "mode".to_owned(),
            got: e.to_string(),
            expected: "none, blind, general or joint".to_owned(),
        })?;
        let tmsd = TmsdWeights::load(&file)?;
        check_blindness(&file, mode, tmsd.as_ref())?;
        let calibration = Calibration::load(&file, key.text_mean.len(), key.bits())?;
        Ok(Self { mode, tmsd, calibration, mixing: Mixing::load(&file)? })
    }
}

/// Refuses an R that its mode cannot have.
fn check_blindness(file: &TensorFile, mode: ExtractorMode, tmsd: Option<&TmsdWeights>) -> Result<(), EngineError> {
    let Some(tmsd) = tmsd else { return Ok(()) };
    let (got, expected) = match mode {
        ExtractorMode::Joint => return Ok(()),
        ExtractorMode::None => ("R", "none in an extractor of mode `none`".to_owned()),
        // A general network would have to be a known one; so far there is none.
        ExtractorMode::Blind | ExtractorMode::General if tmsd.is_trained() => {
            let expected = format!("a colour map alone in an extractor of mode `{mode}`, which never saw a message");
            ("a trained network", expected)
        }
        ExtractorMode::Blind | ExtractorMode::General => return Ok(()),
    };
    Err(file.bad("tmsd", got, &expected))
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
        clip: &Clip,
        tmsd: Option<&TmsdWeights>,
        branches: usize,
        purpose: Purpose,
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
        let batch = &mut self.batches[self.current];
        for (i, clip) in clips.iter().enumerate() {
            match &self.tmsd {
                Some(tmsd) => {
                    tmsd.forward(rec, clip, &mut self.passes[i])?;
                    rec.copy(&self.passes[i].out, 0, &mut batch.stacked, i * len, len)?;
                }
                None => rec.copy(clip, 0, &mut batch.stacked, i * len, len)?,
            }
        }
        Ok(())
    }

    /// The second half: features of what was stacked last. For as many clips it records the same passes on the same buffers
    /// each time, and so does [`FeatureExtractor::backward`], until activations are forgotten.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub fn read(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        let batch = &mut self.batches[self.current];
        normalize::forward(rec, &NORMALIZATION, &batch.stacked, &mut batch.pixels)?;
        self.tower.forward(rec, &batch.pixels, &mut batch.workspace)
    }

    /// Gradient to the first branch's clip, in `self.v_x`; with `train` also to R's weights, over the branches that were
    /// read last.
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
        let batch = &mut self.batches[self.current];
        self.tower.backward(rec, v_features, &mut batch.workspace, &mut batch.pixels)?;
        normalize::backward(rec, &NORMALIZATION, &batch.pixels, &mut batch.v_stacked)?;
        let Some(tmsd) = &mut self.tmsd else { return rec.copy(&batch.v_stacked, 0, &mut self.v_x, 0, len) };
        for (i, pass) in self.passes.iter_mut().enumerate().take(batch.branches) {
            let weights = match train {
                Training::Frozen if i > 0 => continue,
                Training::Frozen => None,
                Training::Tmsd if i == 0 => Some(Accumulate::Overwrite),
                Training::Tmsd => Some(Accumulate::Add),
            };
            rec.copy(&batch.v_stacked, i * len, &mut pass.v_out, 0, len)?;
            tmsd.backward(rec, pass, weights)?;
        }
        rec.copy(&self.passes[0].v_x, 0, &mut self.v_x, 0, len)
    }
}

/// Whether R's weights get gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Training {
    /// R is frozen or absent.
    Frozen,
    /// R is trained.
    Tmsd,
}

/// What an extractor sees in frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sight {
    /// Image features `[n, D]`.
    pub features: Vec<f32>,
    /// Logits of the key's decoder `[n, L]`.
    pub logits: Vec<f32>,
}

impl Sight {
    /// Appends what was seen in further frames.
    pub fn extend(&mut self, more: &Self) {
        self.features.extend_from_slice(&more.features);
        self.logits.extend_from_slice(&more.logits);
    }
}

/// What `key` makes of features that an extractor has seen already: logits `[n, L]`.
///
/// # Errors
/// When the device fails.
pub fn decode(
    device: &Device,
    key: &Key,
    calibration: &Calibration,
    features: &[f32],
) -> Result<Vec<f32>, EngineError> {
    let decoder = Decoder::new(device, &calibration.fold(&key.decoder, &key.codes, &key.text_mean))?;
    let mut pass = decoder.pass(device, features.len() / key.text_mean.len())?;
    let input = device.buffer_from("decode.features", features)?;
    let mut rec = device.recorder()?;
    decoder.forward(&mut rec, &input, &mut pass)?;
    rec.submit()?;
    Ok(pass.logits.read()?)
}

/// A ready extractor that reads 8-bit frames.
#[derive(Debug)]
pub struct Reader {
    device: Device,
    features: FeatureExtractor,
    decoder: Decoder,
    pass: DecoderPass,
    resized: Buffer<f32>,
    bits: usize,
}

impl Reader {
    /// Puts an extractor on the device.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when key and checkpoint do not belong together; when memory runs out.
    pub fn new(device: &Device, clip: &Clip, key: &Key, weights: &ExtractorWeights) -> Result<Self, EngineError> {
        if key.clip != digest_of(clip) {
            return Err(EngineError::Usage {
                what: "CLIP checkpoint".to_owned(),
                got: digest_of(clip).to_string(),
                expected: format!("{}, which the key was made with", key.clip),
            });
        }
        let features = FeatureExtractor::new(device, clip, weights.tmsd.as_ref(), 1, Purpose::Features)?;
        let decoder = Decoder::new(device, &weights.calibration.fold(&key.decoder, &key.codes, &key.text_mean))?;
        Ok(Self {
            pass: decoder.pass(device, CLIP_FRAMES)?,
            resized: device.buffer("reader.resized", features.clip_len())?,
            device: device.clone(),
            features,
            decoder,
            bits: key.bits(),
        })
    }

    /// Logits of every frame `[n, L]`.
    ///
    /// # Errors
    /// Those of [`Reader::look`].
    pub fn logits(&mut self, frames: &[Frame]) -> Result<Vec<f32>, EngineError> {
        Ok(self.look(frames)?.logits)
    }

    /// Features and logits of every frame, seen in clips of [`CLIP_FRAMES`]; a last, shorter clip repeats its last
    /// frame, and the repetitions are not counted.
    ///
    /// # Errors
    /// [`EngineError::Usage`] without a frame or with frames of different sizes; when the device fails.
    pub fn look(&mut self, frames: &[Frame]) -> Result<Sight, EngineError> {
        let Some(first) = frames.first() else {
            return Err(EngineError::Usage {
                what: "clip".to_owned(),
                got: "no frame".to_owned(),
                expected: "at least one frame".to_owned(),
            });
        };
        let mut intake = Intake::new(&self.device, first, self.features.shape())?;
        let mut sight = Sight::default();
        for chunk in frames.chunks(CLIP_FRAMES) {
            intake.load(chunk)?;
            self.see(&mut intake, chunk.len(), Edit::NONE, &mut sight)?;
        }
        Ok(sight)
    }

    /// Looks at frames that come one after the other, of which it holds no more than a clip, as often as there are edits that could
    /// have been done to them, each time without that edit.
    #[must_use]
    pub fn watch(&mut self, done: &[Edit]) -> Watching<'_> {
        let sights = done.iter().map(|&edit| (edit, Sight::default())).collect();
        Watching { reader: self, intake: None, waiting: Vec::new(), sights }
    }

    /// Appends what the first `frames` of the clip that was taken in show.
    fn see(&mut self, intake: &mut Intake, frames: usize, done: Edit, sight: &mut Sight) -> Result<(), EngineError> {
        let mut rec = self.device.recorder()?;
        intake.show(&mut rec, done, &mut self.resized)?;
        self.features.forward(&mut rec, &[&self.resized])?;
        self.decoder.forward(&mut rec, self.features.features(), &mut self.pass)?;
        rec.submit()?;
        let width = self.features.features().len() / CLIP_FRAMES;
        sight.features.extend(self.features.features().read_range(0..frames * width)?);
        sight.logits.extend(self.pass.logits.read_range(0..frames * self.bits)?);
        Ok(())
    }
}

/// Frames of one film on their way through a [`Reader`]. It sees them as [`Reader::look`] does, but for edits.
#[derive(Debug)]
pub struct Watching<'a> {
    reader: &'a mut Reader,
    intake: Option<Intake>,
    waiting: Vec<Frame>,
    /// What is seen without each edit.
    sights: Vec<(Edit, Sight)>,
}

impl Watching<'_> {
    /// Takes the next frame.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a frame of another size than the first, or after [`MAX_FRAMES`]; when the device fails.
    pub fn push(&mut self, frame: Frame) -> Result<(), EngineError> {
        let seen = self.sights.first().map_or(0, |(_, sight)| sight.logits.len() / self.reader.bits);
        let most = MAX_FRAMES / self.sights.len().max(1);
        if seen + self.waiting.len() >= most {
            return Err(EngineError::Usage {
                what: "film".to_owned(),
                got: format!("more than {most} frames"),
                expected: "fewer: read one of several, limit their number, or guess fewer edits".to_owned(),
            });
        }
        self.waiting.push(frame);
        if self.waiting.len() == CLIP_FRAMES { self.see() } else { Ok(()) }
    }

    /// What was seen in all frames without each edit; nothing if there was none.
    ///
    /// # Errors
    /// Those of [`Self::push`].
    pub fn finish(mut self) -> Result<Vec<Sight>, EngineError> {
        if !self.waiting.is_empty() {
            self.see()?;
        }
        Ok(self.sights.into_iter().map(|(_, sight)| sight).collect())
    }

    fn see(&mut self) -> Result<(), EngineError> {
        let Self { reader, intake, waiting, sights } = self;
        let intake = match intake {
            Some(intake) => intake,
            None => intake.insert(Intake::new(&reader.device, &waiting[0], reader.features.shape())?),
        };
        intake.load(waiting)?;
        for (done, sight) in sights {
            reader.see(intake, waiting.len(), *done, sight)?;
        }
        waiting.clear();
        Ok(())
    }
}
