//! Fitting the message-blind parts of an extractor to the unmarked asset.
//!
//! Nothing here sees a message or a marked clip: the inputs are unmarked clips, random offsets, and the key's
//! public-to-itself geometry (token directions).

use guard4d_kernels::Device;
use guard4d_kernels::image::colour_map::ColourMap;
use guard4d_kernels::image::noise::Noise;
use guard4d_kernels::shape::ClipShape;
use nalgebra::{Matrix3, SymmetricEigen};
use rand_chacha::ChaCha20Rng;

use super::config::EmbedConfig;
use super::pool::ClipPool;
use super::step::Stage;
use crate::clip::{Clip, Purpose};
use crate::distortion::{Drawn, Layer};
use crate::error::EngineError;
use crate::render::OffsetBases;
use crate::scene::gaussians::{CHANNELS, Y0};
use crate::watermark::calibration::Calibration;
use crate::watermark::evidence::ExtractorMode;
use crate::watermark::extractor::{CLIP_FRAMES, ExtractorWeights, FeatureExtractor, decode};
use crate::watermark::key::Key;
use crate::watermark::mixing::Mixing;
use crate::watermark::prf::{Prf, Purpose as Stream, standard_normal, uniform_below};
use crate::watermark::scatter::AssetFeatures;
use crate::watermark::tmsd::TmsdWeights;

/// Clips whose logits set the zero.
pub(super) const ZERO_CLIPS: usize = 32;
/// Clips that are copied.
const COPIED_CLIPS: usize = 8;
/// Clips on which each random field is tried.
pub(super) const CLIPS_PER_RESPONSE: usize = 2;
/// Frames of these.
const FRAMES_PER_RESPONSE: usize = CLIPS_PER_RESPONSE * CLIP_FRAMES;

/// R (for all but `none`) and the calibration for one asset, mixed by the key's first rotation; and the features that its zero is the mean of.
pub(super) fn extractor(
    device: &Device,
    clip: &Clip,
    key: &Key,
    config: &EmbedConfig,
    pool: &mut ClipPool,
    stage: &mut Stage,
) -> Result<(ExtractorWeights, Vec<f32>), EngineError> {
    let prf = key.prf();
    let general = config.general.as_deref();
    let tmsd = match config.mode {
        ExtractorMode::None => None,
        _ => {
            let map = colour_map(config, pool, stage)?;
            Some(match general {
                Some(general) => general.tmsd.with_colour_map(map),
                None => TmsdWeights::new(config.tmsd, map, &mut prf.stream(Stream::TmsdInit, config.seed)),
            })
        }
    };
    let mut features = pool.with_room(|| FeatureExtractor::new(device, clip, tmsd.as_ref(), 1, Purpose::Features))?;
    let (bits, mut rng) = (key.bits(), Mixing::FIXED.stream(&prf));
    let calibration = match general {
        Some(general) => {
            let content = content_features(device, &mut features, pool, stage)?.concat();
            Calibration::general(general, &content, bits, &mut rng)?
        }
        None => {
            let seen = Seen::of(device, &mut features, (config, &prf), pool, stage)?;
            Calibration::fit(&seen.features(), bits, &mut rng)?
        }
    };
    let unmarked = unmarked_features(device, &mut features, (config, pool, stage))?;
    let mut weights = ExtractorWeights { mode: config.mode, tmsd, calibration, mixing: Mixing::FIXED };
    pool.with_room(|| set_zero(device, key, &mut weights.calibration, &unmarked))?;
    Ok((weights, unmarked))
}

/// What R and CLIP make of an asset that carries no message.
pub(super) struct Seen {
    content: Vec<f32>,
    copies: Vec<f32>,
    responses: Vec<f32>,
    width: usize,
}

impl Seen {
    /// Reads unmarked clips, copies of them, and random offsets. The offsets of the stage are zero before and after.
    pub(super) fn of(
        device: &Device,
        features: &mut FeatureExtractor,
        (config, prf): (&EmbedConfig, &Prf),
        pool: &mut ClipPool,
        stage: &mut Stage,
    ) -> Result<Self, EngineError> {
        let content = content_features(device, features, pool, stage)?;
        let copies = copies_features(device, features, config, pool, stage)?;
        let responses = responses(device, features, (config, prf), pool, (stage, &content))?;
        let width = features.features().len() / CLIP_FRAMES;
        Ok(Self { content: content.concat(), copies, responses, width })
    }

    pub(super) fn features(&self) -> AssetFeatures<'_> {
        let Self { content, copies, responses, width } = self;
        AssetFeatures { content, copies, responses, frames: FRAMES_PER_RESPONSE, width: *width }
    }
}

/// Sets the mean logits to those of `unmarked` clips ([`unmarked_features`]), as R and the directions are now.
///
/// CLIP gives all clips of one asset much the same feature, so without this an unmarked clip reads as a fixed
/// word; with it the bits fall by content, and each bit's threshold lies in the middle.
pub(super) fn set_zero(
    device: &Device,
    key: &Key,
    calibration: &mut Calibration,
    unmarked: &[f32],
) -> Result<(), EngineError> {
    let bits = key.bits();
    calibration.mean_logits = vec![0.0; bits];
    let (mut sums, mut rows) = (vec![0.0f64; bits], 0.0);
    for row in decode(device, key, calibration, unmarked)?.chunks_exact(bits) {
        sums.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(*v));
        rows += 1.0;
    }
    #[allow(clippy::cast_possible_truncation, reason = "logits are single precision")]
    let means = sums.into_iter().map(|sum| (sum / f64::max(rows, 1.0)) as f32).collect();
    calibration.mean_logits = means;
    Ok(())
}

/// Features `[n, D]` of unmarked clips, clean and noisy.
pub(super) fn unmarked_features(
    device: &Device,
    features: &mut FeatureExtractor,
    (config, pool, stage): (&EmbedConfig, &mut ClipPool, &mut Stage),
) -> Result<Vec<f32>, EngineError> {
    let sigma = (config.noise_sigma.0 * config.noise_sigma.1).sqrt();
    let mut found = Vec::new();
    for (stream, index) in (0..).zip(pool.training().take(ZERO_CLIPS)) {
        let clip = pool.get(index, stage)?;
        for noise in [None, Some(Noise { sigma, seed: config.seed, stream })] {
            let mut rec = device.recorder()?;
            match noise {
                None => features.forward(&mut rec, &[&clip.resized])?,
                Some(noise) => {
                    stage.noisy(&mut rec, &clip, &noise)?;
                    features.forward(&mut rec, &[&stage.noisy_resized])?;
                }
            }
            rec.submit()?;
            found.extend(features.features().read()?);
        }
    }
    Ok(found)
}

/// The colour map that goes with an asset: G λ² (M + λ²)⁻¹.
pub(super) fn colour_map(
    config: &EmbedConfig,
    pool: &mut ClipPool,
    stage: &mut Stage,
) -> Result<ColourMap, EngineError> {
    Ok(silencing(&second_moment(pool, stage)?, config.null_gain, config.null_level))
}

/// E\[x xᵀ\] over all pixels of the resized unmarked clips.
fn second_moment(pool: &mut ClipPool, stage: &mut Stage) -> Result<Matrix3<f64>, EngineError> {
    // Clips come in the order of what is in memory; their sums are added in the order of their numbers.
    let mut sums = vec![(Matrix3::zeros(), 0.0); pool.training().len()];
    for index in pool.training_at_hand_first() {
        let (sum, count) = &mut sums[index];
        for texel in pool.get(index, stage)?.resized.read()?.as_chunks::<4>().0 {
            let x = nalgebra::Vector3::new(f64::from(texel[0]), f64::from(texel[1]), f64::from(texel[2]));
            *sum += x * x.transpose();
            *count += 1.0;
        }
    }
    let (sum, count) = sums.into_iter().fold((Matrix3::zeros(), 0.0), |(sum, n), (s, m)| (sum + s, n + m));
    Ok(sum / f64::max(count, 1.0))
}

/// G λ² (M + λ²)⁻¹: keeps and amplifies the colour directions that the asset leaves unused, and silences the
/// others.
#[allow(clippy::cast_possible_truncation, reason = "weights are single precision")]
fn silencing(moment: &Matrix3<f64>, gain: f64, level: f64) -> ColourMap {
    let eigen = SymmetricEigen::new(*moment);
    let gains = eigen.eigenvalues.map(|w| gain * level * level / (w.max(0.0) + level * level));
    let map = eigen.eigenvectors * Matrix3::from_diagonal(&gains) * eigen.eigenvectors.transpose();
    std::array::from_fn(|i| std::array::from_fn(|j| map[(i, j)] as f32))
}

/// Features of each unmarked clip `[F, D]`.
fn content_features(
    device: &Device,
    features: &mut FeatureExtractor,
    pool: &mut ClipPool,
    stage: &mut Stage,
) -> Result<Vec<Vec<f32>>, EngineError> {
    let mut found = vec![Vec::new(); pool.training().len()];
    for index in pool.training_at_hand_first() {
        let clip = pool.get(index, stage)?;
        let mut rec = device.recorder()?;
        features.forward(&mut rec, &[&clip.resized])?;
        rec.submit()?;
        found[index] = features.features().read()?;
    }
    Ok(found)
}

/// Features of unmarked clips in copies `[m, D]`, at both ends of each range of strengths.
fn copies_features(
    device: &Device,
    features: &mut FeatureExtractor,
    config: &EmbedConfig,
    pool: &mut ClipPool,
    stage: &mut Stage,
) -> Result<Vec<f32>, EngineError> {
    let size = config.frame_size();
    let shape = ClipShape { frames: CLIP_FRAMES, height: size.height, width: size.width };
    let mut layer = pool.with_room(|| Ok(Layer::new(device, shape, &config.calibration_copies)?))?;
    let mut found = Vec::new();
    for (index, distortion) in config.calibration_copies.iter().enumerate() {
        let ends: &[f64] = if distortion.is_fixed() { &[0.0] } else { &[0.0, 1.0] };
        for &share in ends {
            for number in pool.training().take(COPIED_CLIPS) {
                let clip = pool.get(number, stage)?;
                let mut rec = device.recorder()?;
                let drawn = Drawn { index, share, seed: config.seed, stream: 0 };
                stage.copy_control(&mut rec, &clip, (&mut layer, drawn))?;
                features.forward(&mut rec, &[&stage.noisy_resized])?;
                rec.submit()?;
                found.extend(features.features().read()?);
            }
        }
    }
    Ok(found)
}

/// Feature change that each random offset field causes in each of its frames `[k, F, D]`. The fields take the place of the offsets, which are zero
/// again afterwards.
fn responses(
    device: &Device,
    features: &mut FeatureExtractor,
    (config, prf): (&EmbedConfig, &Prf),
    pool: &mut ClipPool,
    (stage, content): (&mut Stage, &[Vec<f32>]),
) -> Result<Vec<f32>, EngineError> {
    let mut rng = prf.stream(Stream::Responses, config.seed);
    let clips = u32::try_from(pool.training().len()).unwrap_or(u32::MAX);
    let mut found = Vec::new();
    for _ in 0..config.responses {
        stage.offsets.write(&random_field(stage.num_splats, stage.bases, config.response_level, &mut rng))?;
        for _ in 0..CLIPS_PER_RESPONSE {
            let index = uniform_below(&mut rng, clips) as usize;
            let clip = pool.get(index, stage)?;
            let mut rec = device.recorder()?;
            stage.render(&mut rec, &clip)?;
            features.forward(&mut rec, &[&stage.resized])?;
            rec.submit()?;
            let moved = features.features().read()?;
            found.extend(moved.iter().zip(&content[index]).map(|(m, c)| m - c));
        }
    }
    stage.offsets.write(&vec![0.0; stage.offsets.len()])?;
    Ok(found)
}

/// DC offsets, which make most of any mark, laid out as `bases` has them.
#[allow(clippy::cast_possible_truncation, reason = "offsets are single precision")]
fn random_field(num_splats: usize, bases: OffsetBases, level: f64, rng: &mut ChaCha20Rng) -> Vec<f32> {
    let row = bases.floats();
    let mut field = vec![0.0; num_splats * row];
    for splat in field.chunks_exact_mut(row) {
        for dc in &mut splat[..CHANNELS] {
            *dc = (standard_normal(rng) * level / Y0) as f32;
        }
    }
    field
}
