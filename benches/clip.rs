//! The image tower of the mini CLIP, forward and back to the pixels.

use guard4d_engine::clip::{Clip, ClipSource, Purpose};

use crate::Outcome;
use crate::harness::{Bench, Work};

/// Three clips of eight frames: the branches of one step in `joint`.
const IMAGES: usize = 24;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let clip = Clip::load(&bench.device, &ClipSource::Mini)?;
    let tower = clip.vision(Purpose::InputGradient)?;
    let config = &clip.config().vision_config;
    let [side, patch, width, inner, layers] =
        [config.image_size, config.patch_size, config.hidden_size, config.intermediate_size, config.num_hidden_layers];
    let (patches, tokens) = ((side / patch).pow(2), config.tokens());
    let layer = tokens * (8 * width * width + 4 * width * inner) + 4 * tokens * tokens * width;
    let ends = patches * 6 * patch * patch * width + 2 * width * clip.config().projection_dim;
    let flops = (IMAGES * (layers * layer + ends)) as f64;

    let pixels = bench.data("pixels", IMAGES * side * side * 4)?;
    let v_features = bench.data("v_features", IMAGES * clip.config().projection_dim)?;
    let mut v_pixels = bench.device.buffer("v_pixels", pixels.len())?;
    let mut workspace = tower.workspace(IMAGES)?;
    let formula = "b·(L·(t·(8w²+4wm)+4t²w) + p·6s²w + 2wd)";
    bench.passes(&format!("clip/mini forward {IMAGES} images"), Work::Flops(flops, formula), |rec| {
        tower.forward(rec, &pixels, &mut workspace)
    })?;
    let formula = "2·b·(L·(t·(8w²+4wm)+4t²w) + p·6s²w + 2wd)";
    let work = Work::Flops(2.0 * flops, formula);
    bench.passes(&format!("clip/mini forward and backward {IMAGES} images"), work, |rec| {
        tower.forward(rec, &pixels, &mut workspace)?;
        tower.backward(rec, &v_features, &mut workspace, &mut v_pixels)
    })
}
