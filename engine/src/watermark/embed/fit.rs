//! Fitting the message-blind parts of an extractor to the unmarked asset.
//!
//! Nothing here sees a message or a marked clip: the inputs are unmarked clips, random offsets, and the key's
//! public-to-itself geometry (token directions).

use guard4d_kernels::Device;
use guard4d_kernels::image::colour_map::ColourMap;
use guard4d_kernels::image::noise::Noise;
use guard4d_kernels::shape::{ClipShape, OffsetBases};
use nalgebra::{Matrix3, SymmetricEigen};
use rand_chacha::ChaCha20Rng;

use super::config::{CalibrationConfig, ContentChoice, Extractor, JointConfig};
use super::fit_context::FitContext;
use super::foretold::{ClipContent, Foretold};
use crate::base::prf::{self, standard_normal, uniform_below};
use crate::error::EngineError;
use crate::networks::clip::{ClipModel, TowerPurpose};
use crate::picture::distortion::{Distortion, DistortionLayer, Drawn};
use crate::scene::gaussians::{CHANNELS, Y0};
use crate::watermark::extractor::calibration::Calibration;
use crate::watermark::extractor::content::{Thumbnailer, take_off};
use crate::watermark::extractor::features::FeatureExtractor;
use crate::watermark::extractor::reader::decode;
use crate::watermark::extractor::rotation::KeyRotation;
use crate::watermark::extractor::scatter::AssetFeatures;
use crate::watermark::extractor::tmsd::{TmsdConfig, TmsdWeights};
use crate::watermark::extractor::weights::{CLIP_FRAMES, ExtractorWeights};
use crate::watermark::key::owner_key::Key;

/// Clips whose logits set the zero.
pub(super) const ZERO_CLIPS: usize = 32;
/// Clips that are copied.
const COPIED_CLIPS: usize = 8;
/// Clips on which each random field is tried.
pub(super) const CLIPS_PER_PROBE: usize = 2;
/// Frames of these.
const FRAMES_PER_PROBE: usize = CLIPS_PER_PROBE * CLIP_FRAMES;

/// An extractor for one asset.
pub(super) struct Fitted {
    /// R (for all but `none`) and the calibration, mixed by the key's first rotation.
    pub(super) weights: ExtractorWeights,
    /// The features that its zero is the mean of.
    pub(super) unmarked: Vec<f32>,
    /// What clips are foretold to say unmarked, which was taken off all of this.
    pub(super) foretold: Option<Foretold>,
}

/// Fits an extractor to the unmarked asset.
pub(super) fn extractor(context: &mut FitContext<'_>, clip: &ClipModel, key: &Key) -> Result<Fitted, EngineError> {
    let (device, config, prf) = (context.device, context.config, context.prf);
    let tmsd = tmsd(context)?;
    let mut features =
        context.pool.with_room(|| FeatureExtractor::new(device, clip, tmsd.as_ref(), 1, TowerPurpose::Features))?;
    let (bits, mut rng) = (key.bits(), KeyRotation::FIXED.stream(prf));
    let mut thumbnailer = match config.extractor.content() {
        ContentChoice::Foretold => Some(context.pool.with_room(|| Ok(Thumbnailer::new(device, features.shape())?))?),
        ContentChoice::Mean => None,
    };
    let content = content(context, &mut features, thumbnailer.as_mut())?;
    let mut foretold = thumbnailer.map(|thumbnailer| Foretold::fit(thumbnailer, &content)).transpose()?;
    let calibration = match &config.extractor {
        Extractor::Pretrained(pretrained) => {
            let content = freed(content, foretold.as_ref());
            Calibration::pretrained(pretrained.weights.get()?, &content, bits, &mut rng)?
        }
        Extractor::None(_) | Extractor::Blind(_) | Extractor::Joint(_) => {
            let seen = Seen::of(context, &mut features, content, foretold.as_mut())?;
            Calibration::fit(&seen.features(), bits, &mut rng)?
        }
    };
    let unmarked = unmarked_features(context, &mut features, foretold.as_mut())?;
    let mut weights = ExtractorWeights {
        mode: config.mode(),
        tmsd,
        calibration,
        key_rotation: KeyRotation::FIXED,
        known_views: context.pool.known_views(),
        content: foretold.as_ref().map(Foretold::model),
    };
    context.pool.with_room(|| set_zero(device, key, &mut weights.calibration, &unmarked))?;
    Ok(Fitted { weights, unmarked, foretold })
}

/// R as it is before it is trained.
fn tmsd(context: &mut FitContext<'_>) -> Result<Option<TmsdWeights>, EngineError> {
    let Some(map) = colour_map(context)? else { return Ok(None) };
    let own = |size: TmsdConfig| {
        TmsdWeights::new(size, map, &mut context.prf.stream(prf::Purpose::TmsdInit, context.config.seed))
    };
    Ok(match &context.config.extractor {
        Extractor::None(_) => None,
        Extractor::Blind(_) => Some(own(TmsdConfig::colour_map_only())),
        Extractor::Pretrained(pretrained) => Some(pretrained.weights.get()?.tmsd.with_colour_map(map)),
        Extractor::Joint(JointConfig { tmsd, .. }) => Some(own(*tmsd)),
    })
}

/// What R and CLIP make of an asset that carries no message.
pub(super) struct Seen {
    content: Vec<f32>,
    copies: Vec<f32>,
    probes: Vec<f32>,
    width: usize,
}

impl Seen {
    /// Reads copies of unmarked clips, and random offsets, where there is a calibration. `content` is what the clips
    /// themselves say; what is foretold is taken off it and off the copies.
    pub(super) fn of(
        context: &mut FitContext<'_>,
        features: &mut FeatureExtractor,
        content: Vec<ClipContent>,
        mut foretold: Option<&mut Foretold>,
    ) -> Result<Self, EngineError> {
        let (mut copies, mut probes) = (Vec::new(), Vec::new());
        if let Some(calibration) = context.config.extractor.calibration() {
            copies = copies_features(context, features, &calibration.copies, foretold.as_deref_mut())?;
            probes = calibration_probes(context, features, calibration, &content)?;
        }
        let width = features.features().len() / CLIP_FRAMES;
        Ok(Self { content: freed(content, foretold.as_deref()), copies, probes, width })
    }

    pub(super) fn features(&self) -> AssetFeatures<'_> {
        let Self { content, copies, probes, width } = self;
        AssetFeatures { content, copies, responses: probes, frames: FRAMES_PER_PROBE, width: *width }
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

/// Features of unmarked clips one after the other `[n, D]`, free of what is foretold.
fn freed(content: Vec<ClipContent>, foretold: Option<&Foretold>) -> Vec<f32> {
    let freed = content.into_iter().enumerate().map(|(number, ClipContent { mut features, .. })| {
        if let Some(told) = foretold.and_then(|foretold| foretold.known(number)) {
            take_off(&mut features, told);
        }
        features
    });
    freed.flatten().collect()
}

/// Features `[n, D]` of unmarked clips, clean and noisy, free of what is foretold.
pub(super) fn unmarked_features(
    context: &mut FitContext<'_>,
    features: &mut FeatureExtractor,
    mut foretold: Option<&mut Foretold>,
) -> Result<Vec<f32>, EngineError> {
    let FitContext { device, config, pool, buffers, .. } = context;
    let (low, high) = config.objective.noise_sigma;
    let sigma = (low * high).sqrt();
    let mut found = Vec::new();
    for (stream, index) in (0..).zip(pool.sampled().take(ZERO_CLIPS)) {
        let clip = pool.get(index, buffers)?;
        for noise in [None, Some(Noise { sigma, seed: config.seed, stream })] {
            let mut rec = device.recorder()?;
            match noise {
                None => buffers.clean_control(&mut rec, &clip)?,
                Some(noise) => buffers.noisy_control(&mut rec, &clip, &noise)?,
            }
            features.forward(&mut rec, &[buffers.control()])?;
            rec.submit()?;
            let mut seen = features.features().read()?;
            if let Some(foretold) = foretold.as_deref_mut() {
                take_off(&mut seen, foretold.of_clip(device, buffers, index, &clip)?);
            }
            found.extend(seen);
        }
    }
    Ok(found)
}

/// The colour map that goes with an asset, G λ² (M + λ²)⁻¹; none without an R.
pub(super) fn colour_map(context: &mut FitContext<'_>) -> Result<Option<ColourMap>, EngineError> {
    let Some(colours) = context.config.extractor.colours() else { return Ok(None) };
    Ok(Some(silencing(&second_moment(context)?, colours.null_gain, colours.null_level)))
}

/// E\[x xᵀ\] over all pixels of the resized unmarked clips.
fn second_moment(context: &mut FitContext<'_>) -> Result<Matrix3<f64>, EngineError> {
    let FitContext { device, pool, buffers, .. } = context;
    // Clips come in the order of what is in memory; their sums are added in the order of their numbers.
    let mut sums = vec![(Matrix3::zeros(), 0.0); pool.sampled().len()];
    for index in pool.at_hand_first(pool.sampled()) {
        let (sum, count) = &mut sums[index];
        let clip = pool.look(index, buffers)?;
        let mut rec = device.recorder()?;
        buffers.clean_control(&mut rec, &clip)?;
        rec.submit()?;
        for texel in buffers.control().read()?.as_chunks::<4>().0 {
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

/// The content of each unmarked clip.
pub(super) fn content(
    context: &mut FitContext<'_>,
    features: &mut FeatureExtractor,
    mut thumbnailer: Option<&mut Thumbnailer>,
) -> Result<Vec<ClipContent>, EngineError> {
    let FitContext { device, pool, buffers, .. } = context;
    let mut found = vec![ClipContent::default(); pool.fitted().len()];
    for index in pool.at_hand_first(pool.fitted()) {
        let clip = pool.look(index, buffers)?;
        let mut rec = device.recorder()?;
        buffers.clean_control(&mut rec, &clip)?;
        features.forward(&mut rec, &[buffers.control()])?;
        if let Some(thumbnailer) = &mut thumbnailer {
            thumbnailer.record(&mut rec, buffers.control())?;
        }
        rec.submit()?;
        let thumbnails = thumbnailer.as_ref().map(|thumbnailer| thumbnailer.read()).transpose()?;
        found[index] =
            ClipContent { features: features.features().read()?, thumbnails: thumbnails.unwrap_or_default() };
    }
    Ok(found)
}

/// Features of unmarked clips in copies `[m, D]`, at both ends of each range of strengths, free of what is foretold of
/// the copies.
fn copies_features(
    context: &mut FitContext<'_>,
    features: &mut FeatureExtractor,
    copies: &[Distortion],
    mut foretold: Option<&mut Foretold>,
) -> Result<Vec<f32>, EngineError> {
    let FitContext { device, config, pool, buffers, .. } = context;
    let size = config.views.frame_size();
    let shape = ClipShape { frames: CLIP_FRAMES, height: size.height, width: size.width };
    let mut layer = pool.with_room(|| Ok(DistortionLayer::new(device, shape, copies)?))?;
    let mut found = Vec::new();
    for (index, distortion) in copies.iter().enumerate() {
        let ends: &[f64] = if distortion.is_fixed() { &[0.0] } else { &[0.0, 1.0] };
        for &share in ends {
            for number in pool.sampled().take(COPIED_CLIPS) {
                let clip = pool.get(number, buffers)?;
                let mut rec = device.recorder()?;
                let drawn = Drawn { index, share, seed: config.seed, stream: 0 };
                buffers.copy_control(&mut rec, &clip, &mut layer, drawn)?;
                features.forward(&mut rec, &[buffers.control()])?;
                rec.submit()?;
                let mut seen = features.features().read()?;
                if let Some(foretold) = foretold.as_deref_mut() {
                    take_off(&mut seen, &foretold.of_frames(device, buffers.control())?);
                }
                found.extend(seen);
            }
        }
    }
    Ok(found)
}

/// Feature change that each random offset field causes in each of its frames `[k, F, D]`. The fields take the place of
/// the offsets, which are zero again afterwards.
fn calibration_probes(
    context: &mut FitContext<'_>,
    features: &mut FeatureExtractor,
    calibration: &CalibrationConfig,
    content: &[ClipContent],
) -> Result<Vec<f32>, EngineError> {
    let FitContext { device, config, prf, pool, buffers } = context;
    let mut rng = prf.stream(prf::Purpose::Responses, config.seed);
    let clips = u32::try_from(pool.fitted().len()).unwrap_or(u32::MAX);
    let (num_splats, bases) = (buffers.offsets.num_splats(), buffers.offsets.bases());
    let mut found = Vec::new();
    for _ in 0..calibration.probes {
        buffers.offsets.write(&random_field(num_splats, bases, calibration.probe_level, &mut rng))?;
        for _ in 0..CLIPS_PER_PROBE {
            let index = uniform_below(&mut rng, clips) as usize;
            let clip = pool.look(index, buffers)?;
            let mut rec = device.recorder()?;
            buffers.render(&mut rec, &clip)?;
            features.forward(&mut rec, &[buffers.resized()])?;
            rec.submit()?;
            let moved = features.features().read()?;
            found.extend(moved.iter().zip(&content[index].features).map(|(m, c)| m - c));
        }
    }
    buffers.offsets.write(&vec![0.0; num_splats * bases.floats()])?;
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
