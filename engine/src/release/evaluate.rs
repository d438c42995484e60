//! What a mark is worth on frames that nobody trained on: 8-bit pictures of unseen views and times.

use std::collections::BTreeMap;

use guard4d_kernels::Device;
use guard4d_kernels::image::resize::ImageSize;
use rand_chacha::ChaCha20Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::base::prf::{Prf, Purpose, standard_normal};
use crate::error::EngineError;
use crate::evidence::control::ChanceDeviation;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::evidence::id_code::{IdBits, IdCode, SearchedP};
use crate::evidence::message::Message;
use crate::evidence::per_bit::PerBit;
use crate::evidence::reading::Reading;
use crate::media::Frame;
use crate::networks::clip::ClipModel;
use crate::networks::lpips::{Lpips, LpipsPass, size_of_frame};
use crate::picture::colour_difference::{ColourDifference, pixels_within};
use crate::picture::metrics::{Picture, PsnrSummary, SquaredError, foreground, ssim};
use crate::render::SceneRenderer;
use crate::scene::camera::classes::CameraClass;
use crate::scene::{Camera, CameraSet, Gaussians, Model};
use crate::watermark::extractor::reader::Reader;
use crate::watermark::extractor::rotation::KeyRotation;
use crate::watermark::extractor::weights::ExtractorWeights;
use crate::watermark::key::owner_key::Key;

/// A pixel belongs to the object when less light than this comes from behind it.
const FOREGROUND_TRANSMITTANCE: f32 = 0.5;
/// Standard deviation of the noisy control at verification.
const NOISE_SIGMA: f64 = 0.02;
/// Confidence of the band that controls are compared with.
const BAND: f64 = 0.99;

/// Frames of one camera set before and after marking.
#[derive(Debug)]
pub struct HeldOut {
    /// Clips of marked 8-bit frames, one per view.
    pub marked: Vec<Vec<Frame>>,
    /// Clips of clean 8-bit frames.
    pub clean: Vec<Vec<Frame>>,
    /// Squared errors per frame, whole and foreground; marked 8-bit against clean float.
    errors: Vec<(SquaredError, SquaredError)>,
    ssim: Vec<f64>,
    /// CIEDE2000 of the object, 8-bit against 8-bit; `None` where no frame shows it.
    colour_difference: Option<ColourDifference>,
}

/// Bit accuracies over clips (mean logits of each clip) and fidelity.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// Mode of the extractor.
    pub mode: ExtractorMode,
    /// Its rotation.
    pub key_rotation: KeyRotation,
    /// Clips.
    pub clips: usize,
    /// Message bits.
    pub bits: usize,
    /// Share of bits right on marked clips.
    pub marked: f64,
    /// The same frame by frame.
    pub marked_frames: f64,
    /// Matches of each marked clip.
    pub matches: Vec<u32>,
    /// Marked clips that each give back the number that was written, as the best of all numbers; left out where the
    /// message is no number. See [`Evaluation::count_ids`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ids: Option<usize>,
    /// Readings of the marked clips.
    #[serde(skip)]
    pub readings: Vec<Reading>,
    /// p-value of each marked clip alone, by the soft score, times the rotations that there were to choose from; for
    /// `joint` what it would be if R had not seen the message.
    pub p_values: Vec<f64>,
    /// What films of each class of cameras showed; left out where they were not measured. See [`ClassFilms`].
    ///
    /// [`ClassFilms`]: super::classes::ClassFilms
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub classes: BTreeMap<CameraClass, ClassFigure>,
    /// Share of the message's bits that clean clips show.
    pub clean: f64,
    /// The same count against what chance gives.
    pub clean_leak: ChanceDeviation,
    /// The same bit by bit.
    pub clean_bits: PerBit,
    /// The same with noise on the clean clips.
    pub noisy: f64,
    /// The same count against what chance gives.
    pub noisy_leak: ChanceDeviation,
    /// The same bit by bit.
    pub noisy_bits: PerBit,
    /// Whole-frame fidelity.
    pub psnr: PsnrSummary,
    /// Fidelity of the object alone.
    pub foreground_psnr: PsnrSummary,
    /// How different the object's colours look.
    pub colour_difference: ColourDifference,
    /// Mean SSIM.
    pub ssim: f64,
    /// Mean LPIPS of the 8-bit frames, when a network for it was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

/// What was measured in the films of one class.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassFigure {
    /// Films, each once around the asset.
    pub films: u32,
    /// Frames of each, spread over the motion.
    pub frames: u32,
    /// Share of bits right: mean over films, logits averaged over a film first.
    pub bit_accuracy: f64,
    /// Share of the films that each prove the message alone, at the rate of the gate's decision rule; for `joint` what
    /// it would be if R had not seen the message.
    pub proven: f64,
}

impl HeldOut {
    /// Renders `cameras` in the clean and in the marked scene.
    ///
    /// # Errors
    /// When the device fails.
    pub fn render(device: &Device, model: &Model, marked_sh: &[f32], cameras: &CameraSet) -> Result<Self, EngineError> {
        let clips = cameras.clips();
        let clean_frames = render(device, model, &model.gaussians, &clips)?;
        let gaussians = Gaussians { sh_coeffs: marked_sh.to_vec(), ..model.gaussians.clone() };
        let marked_frames = render(device, model, &gaussians, &clips)?;
        let pairs: Vec<_> = clean_frames
            .par_iter()
            .zip(&marked_frames)
            .map(|(clean, marked)| Pair::of(clean, marked))
            .collect::<Result<_, _>>()?;
        let empty = || vec![Vec::new(); clips.len()];
        let mut out =
            Self { marked: empty(), clean: empty(), errors: Vec::new(), ssim: Vec::new(), colour_difference: None };
        let mut colour_differences = Vec::new();
        for (pair, RenderedFrame { clip: number, .. }) in pairs.into_iter().zip(&clean_frames) {
            out.errors.push(pair.errors);
            out.ssim.push(pair.ssim);
            colour_differences.extend(pair.colour_differences);
            out.clean[*number].push(pair.clean);
            out.marked[*number].push(pair.marked);
        }
        out.colour_difference = ColourDifference::of(colour_differences);
        Ok(out)
    }

    /// The same clips after something happened to all of them, marked and clean alike. Fidelity stays that of the clips
    /// as they were rendered.
    ///
    /// # Errors
    /// What `change` returns.
    pub fn changed(
        self,
        mut change: impl FnMut(&[Frame]) -> Result<Vec<Frame>, EngineError>,
    ) -> Result<Self, EngineError> {
        let mut all = |clips: &[Vec<Frame>]| clips.iter().map(|clip| change(clip)).collect::<Result<Vec<_>, _>>();
        Ok(Self { marked: all(&self.marked)?, clean: all(&self.clean)?, ..self })
    }

    /// Whole-frame fidelity.
    ///
    /// # Errors
    /// [`EngineError::Usage`] without a frame.
    pub fn psnr(&self) -> Result<PsnrSummary, EngineError> {
        summary(self.errors.iter().map(|(whole, _)| *whole))
    }

    /// Mean LPIPS over all frames, marked against clean, both in 8 bits.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for frames that are too small; [`EngineError::NotFinite`] without a frame; when the
    /// device fails.
    pub fn lpips(&self, net: &Lpips) -> Result<f64, EngineError> {
        let (mut sum, mut frames) = (0.0, 0.0);
        let mut room: Option<(ImageSize, LpipsPass)> = None;
        for (marked, clean) in self.marked.iter().flatten().zip(self.clean.iter().flatten()) {
            let size = size_of_frame(marked);
            let mut pass = match room.take().filter(|(fits, _)| *fits == size) {
                Some((_, pass)) => pass,
                None => net.pass(size, 1)?,
            };
            sum += net.distance_with(&mut pass, marked, clean)?.total();
            frames += 1.0;
            room = Some((size, pass));
        }
        let mean = sum / frames;
        match mean.is_finite() {
            true => Ok(mean),
            false => Err(EngineError::NotFinite { what: "LPIPS of the held-out frames".to_owned(), got: mean }),
        }
    }

    /// Reads the message from marked, clean and noisy clips.
    ///
    /// # Errors
    /// When key, checkpoint and extractor do not belong together; when the device fails.
    pub fn evaluate(
        &self,
        device: &Device,
        clip: &ClipModel,
        key: &Key,
        extractor: &ExtractorWeights,
        message: &Message,
    ) -> Result<Evaluation, EngineError> {
        let mut reader = Reader::new(device, clip, key, extractor)?;
        let mut noise = key.prf().stream(Purpose::ControlNoise, 0);
        let noisy: Vec<Vec<Frame>> = self
            .clean
            .iter()
            .map(|clip| clip.iter().map(|frame| with_noise(frame, &mut noise)).collect::<Result<_, _>>())
            .collect::<Result<_, EngineError>>()?;
        let marked = read_clips(&mut reader, &self.marked, key.bits())?;
        let clean = read_clips(&mut reader, &self.clean, key.bits())?;
        let noisy = read_clips(&mut reader, &noisy, key.bits())?;
        let matches = marked.iter().map(|r| r.matches(message)).collect::<Result<Vec<_>, _>>()?;
        let p_values = p_values(&marked, message, extractor.key_rotation)?;
        let frames = marked.iter().map(|r| r.frame_accuracy(message)).collect::<Result<Vec<_>, _>>()?;
        let accuracy = mean_accuracy(&marked, message)?;
        Ok(Evaluation {
            mode: extractor.mode,
            key_rotation: extractor.key_rotation,
            clips: marked.len(),
            bits: key.bits(),
            marked: accuracy,
            marked_frames: frames.iter().map(|f| f.mean).sum::<f64>() / frames.len().max(1) as f64,
            matches,
            ids: None,
            readings: marked,
            p_values,
            classes: BTreeMap::new(),
            clean: mean_accuracy(&clean, message)?,
            clean_leak: chance_deviation(&clean, message)?,
            clean_bits: PerBit::of(&clean, message)?,
            noisy: mean_accuracy(&noisy, message)?,
            noisy_leak: chance_deviation(&noisy, message)?,
            noisy_bits: PerBit::of(&noisy, message)?,
            psnr: self.psnr()?,
            colour_difference: self.colour_difference.ok_or_else(no_frame)?,
            foreground_psnr: summary(self.errors.iter().map(|(_, object)| *object))?,
            ssim: self.ssim.iter().sum::<f64>() / self.ssim.len().max(1) as f64,
            lpips: None,
        })
    }
}

fn summary(errors: impl Iterator<Item = SquaredError>) -> Result<PsnrSummary, EngineError> {
    PsnrSummary::of(&errors.collect::<Vec<_>>()).ok_or_else(no_frame)
}

fn no_frame() -> EngineError {
    EngineError::Usage {
        what: "held-out cameras".to_owned(),
        got: "no frame that shows the object".to_owned(),
        expected: "at least one view at one time".to_owned(),
    }
}

impl Evaluation {
    /// Marked clips whose message was read without a wrong bit.
    #[must_use]
    pub fn exact(&self) -> usize {
        self.matches.iter().filter(|&&matches| matches as usize == self.bits).count()
    }

    /// Decodes every marked clip as a number of this kind, and counts those that give `message`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a message of a length that the code has not.
    pub fn count_ids(&mut self, id_bits: IdBits, prf: &Prf, message: &Message) -> Result<(), EngineError> {
        let code = IdCode::new(id_bits, message.num_bits())?;
        let pad = code.pad(prf)?;
        let mut right = 0;
        for reading in &self.readings {
            let found = code.decode(reading.mean_logits(), &pad)?;
            right += usize::from(code.message(found.id, &pad)? == *message);
        }
        self.ids = Some(right);
        Ok(())
    }

    /// Share of the marked clips that each prove the message alone, at a false-positive rate of `fpr`.
    #[must_use]
    pub fn proven(&self, fpr: f64) -> f64 {
        share_proving(&self.p_values, fpr)
    }
}

/// p-value of each reading alone, by the soft score, times the rotations that there were to choose from.
///
/// # Errors
/// [`EngineError::Usage`] when lengths differ.
pub(super) fn p_values(
    readings: &[Reading],
    message: &Message,
    key_rotation: KeyRotation,
) -> Result<Vec<f64>, EngineError> {
    readings.iter().map(|r| SearchedP::of(r, message, key_rotation.of).map(|p| p.soft_score)).collect()
}

/// Share of the p-values that are no larger than `fpr`.
pub(super) fn share_proving(p_values: &[f64], fpr: f64) -> f64 {
    p_values.iter().filter(|&&p| p <= fpr).count() as f64 / p_values.len().max(1) as f64
}

/// Readings of clips, one each.
///
/// # Errors
/// When the device fails.
pub fn read_clips(reader: &mut Reader, clips: &[Vec<Frame>], bits: usize) -> Result<Vec<Reading>, EngineError> {
    let bits = u32::try_from(bits).unwrap_or(u32::MAX);
    clips.iter().map(|clip| Reading::from_logits(&reader.logits(clip)?, bits)).collect()
}

/// Mean share of `message` that the readings show.
///
/// # Errors
/// [`EngineError::Usage`] when lengths differ.
pub fn mean_accuracy(readings: &[Reading], message: &Message) -> Result<f64, EngineError> {
    let mut sum = 0.0;
    for reading in readings {
        sum += reading.decoded().bit_accuracy(message)?;
    }
    Ok(sum / readings.len().max(1) as f64)
}

/// Bits of `message` that the readings show, all together, against the two-sided 99 % band of as many coin flips.
///
/// Clips of one asset and key are not independent of one another, so chance leaves this band more often than that.
///
/// # Errors
/// [`EngineError::Usage`] when lengths differ.
pub fn chance_deviation(readings: &[Reading], message: &Message) -> Result<ChanceDeviation, EngineError> {
    let (mut matches, mut bits) = (0, 0);
    for reading in readings {
        matches += reading.matches(message)?;
        bits += message.num_bits();
    }
    ChanceDeviation::measure(matches, bits, BAND)
}

/// One frame before it is rounded.
struct RenderedFrame {
    /// Number of its clip.
    clip: usize,
    width: u32,
    height: u32,
    /// `[H,W,4]`
    pixels: Vec<f32>,
}

/// One frame in 8 bits without and with the mark, and how far apart they are.
struct Pair {
    clean: Frame,
    marked: Frame,
    /// Of the whole frame and of the object, marked 8-bit against clean float.
    errors: (SquaredError, SquaredError),
    ssim: f64,
    colour_differences: Vec<f32>,
}

impl Pair {
    fn of(clean: &RenderedFrame, marked: &RenderedFrame) -> Result<Self, EngineError> {
        let (width, height) = (clean.width, clean.height);
        let marked = Frame::from_rgba32f(width, height, &marked.pixels)?;
        let clamped: Vec<f32> = clean.pixels.iter().map(|v| v.clamp(0.0, 1.0)).collect();
        let (picture, reference) = (Picture::from_frame(&marked), Picture::from_rgba32f(width, height, &clamped)?);
        let mask = foreground(clean.pixels.iter().skip(3).step_by(4).copied(), FOREGROUND_TRANSMITTANCE);
        let whole = SquaredError::between(&picture, &reference)?;
        let errors = (whole, SquaredError::within(&picture, &reference, &mask)?);
        let ssim = ssim(&picture, &reference)?;
        let clean = Frame::from_rgba32f(width, height, &clean.pixels)?;
        let colour_differences = pixels_within(&marked, &clean, &mask)?;
        Ok(Self { clean, marked, errors, ssim, colour_differences })
    }
}

fn render(
    device: &Device,
    model: &Model,
    gaussians: &Gaussians,
    clips: &[Vec<(Camera, f32)>],
) -> Result<Vec<RenderedFrame>, EngineError> {
    let mut frames = Vec::new();
    let mut renderer = SceneRenderer::new(device, gaussians, &model.motion, model.background)?;
    renderer.render_clips(clips, |clip, camera, pixels| {
        let (width, height) = (camera.width, camera.height);
        frames.push(RenderedFrame { clip, width, height, pixels: pixels.to_vec() });
        Ok(())
    })?;
    Ok(frames)
}

/// An 8-bit frame with Gaussian noise, rounded again.
#[allow(clippy::cast_possible_truncation, reason = "colours are single precision")]
fn with_noise(frame: &Frame, rng: &mut ChaCha20Rng) -> Result<Frame, EngineError> {
    let pixels: Vec<f32> = frame.to_rgba32f().iter().map(|v| v + (NOISE_SIGMA * standard_normal(rng)) as f32).collect();
    Frame::from_rgba32f(frame.width(), frame.height(), &pixels)
}
