//! Image towers, forward and back to the pixels: of the mini CLIP, and of one that is as large as ViT-B/32.

use std::path::PathBuf;

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::{ClipConfig, ClipModel, ClipSource, Precision, TextConfig, TowerPurpose};
use guard4d_kernels::Device;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::harness::{Bench, Outcome, Work};

/// Three clips of eight frames: the branches of one step in `joint`.
const MINI_IMAGES: usize = 24;
/// One clip.
const LARGE_IMAGES: usize = 8;
const LARGE: &str = "ViT-B/32";
const SEED: u64 = 1;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    for precision in precisions(bench) {
        tower(bench, "mini", bench.size(MINI_IMAGES, 1), precision, |device| {
            ClipModel::load(device, &ClipSource::Mini)
        })?;
        tower(bench, LARGE, bench.size(LARGE_IMAGES, 1), precision, random)?;
    }
    Ok(())
}

/// All that the device can do.
fn precisions(bench: &Bench) -> Vec<Precision> {
    let half = bench.device.info().cooperation.map(|_| Precision::Half);
    [Precision::F32, Precision::Fixed16].into_iter().chain(half).collect()
}

/// A checkpoint with the image tower of ViT-B/32, whose sizes are the defaults, and hardly any text tower. Random
/// weights of the usual size take as long as trained ones.
fn random(device: &Device) -> Result<ClipModel, EngineError> {
    let text_config = TextConfig {
        vocab_size: 16,
        hidden_size: 8,
        intermediate_size: 8,
        num_hidden_layers: 1,
        num_attention_heads: 1,
        ..TextConfig::default()
    };
    let config = serde_json::json!({ "text_config": text_config }).to_string();
    let path = PathBuf::from(LARGE);
    let sizes = ClipConfig::from_json(&path, config.as_bytes())?;
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut tensor = |name: &str, shape: &[usize]| {
        let inputs = shape.iter().skip(1).product::<usize>();
        // Matrices keep the length of what they multiply; norms, of one axis, scale by about one.
        let (centre, width) = match shape.len() {
            0 | 1 if name.ends_with("weight") => (1.0, 0.1),
            0 | 1 => (0.0, 0.1),
            _ => (0.0, (3.0 / inputs as f32).sqrt()),
        };
        let mut value = || centre + width * ((rng.next_u32() >> 8) as f32 / (1 << 23) as f32 - 1.0);
        Tensor::f32(shape, (0..shape.iter().product()).map(|_| value()).collect())
    };
    let tensors = sizes.tensors();
    let tensors = tensors.iter().map(|(name, shape)| (name.clone(), tensor(name, shape))).collect();
    let weights = TensorFile { path, tensors, ..TensorFile::default() }.to_bytes()?;
    ClipModel::load(device, &ClipSource::Bytes { config: config.as_bytes(), weights: &weights })
}

/// Rows of one tower; its weights are made only if a row is wanted.
fn tower(
    bench: &mut Bench,
    label: &str,
    images: usize,
    precision: Precision,
    load: impl Fn(&Device) -> Result<ClipModel, EngineError>,
) -> Outcome {
    let kept = match precision {
        Precision::F32 => "",
        Precision::Fixed16 => ", 16-bit weights",
        Precision::Half => ", f16",
    };
    let name = |way| format!("clip/{label} {way} {images} images{kept}");
    let [forward, both] = ["forward", "forward and backward"].map(name);
    if !bench.wants(&forward) && !bench.wants(&both) {
        return Ok(());
    }
    let clip = load(&bench.device)?.in_precision(precision);
    let tower = clip.vision(TowerPurpose::InputGradient)?;
    let config = &clip.config().vision_config;
    let [side, patch, width, inner, layers] =
        [config.image_size, config.patch_size, config.hidden_size, config.intermediate_size, config.num_hidden_layers];
    let (patches, tokens) = ((side / patch).pow(2), config.tokens());
    let layer = tokens * (8 * width * width + 4 * width * inner) + 4 * tokens * tokens * width;
    let ends = patches * 6 * patch * patch * width + 2 * width * clip.config().projection_dim;
    let flops = (images * (layers * layer + ends)) as f64;

    let pixels = bench.data("pixels", images * side * side * 4)?;
    let v_features = bench.data("v_features", images * clip.config().projection_dim)?;
    let mut v_pixels = bench.device.buffer("v_pixels", pixels.len())?;
    let mut workspace = tower.workspace(images)?;
    let formula = "b·(L·(t·(8w²+4wm)+4t²w) + p·6s²w + 2wd)";
    bench.passes(&forward, Work::Flops(flops, formula), |rec| tower.forward(rec, &pixels, &mut workspace))?;
    let formula = "2·b·(L·(t·(8w²+4wm)+4t²w) + p·6s²w + 2wd)";
    let work = Work::Flops(2.0 * flops, formula);
    bench.passes(&both, work, |rec| {
        tower.forward(rec, &pixels, &mut workspace)?;
        tower.backward(rec, &v_features, &mut workspace, &mut v_pixels)
    })
}
