//! CLIP towers against transformers, and checkpoints that must be refused.

mod model;
mod weights;

use guard4d_engine::base::tensor_file::{TensorFile, Values};

/// Sizes of a tower's transformer.
pub(crate) struct Tower {
    pub(crate) width: usize,
    pub(crate) inner: usize,
    pub(crate) layers: usize,
}

/// Sizes of a checkpoint.
pub(crate) struct Dims {
    pub(crate) projection: usize,
    pub(crate) vocab: usize,
    pub(crate) positions: usize,
    pub(crate) text: Tower,
    pub(crate) vision: Tower,
    pub(crate) patch: usize,
    pub(crate) patches: usize,
}

impl Dims {
    /// Names and shapes of all tensors, written down here once more: the loader's own list is under test.
    pub(crate) fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        let (text, vision) = (self.text.width, self.vision.width);
        let mut all = vec![
            ("logit_scale".to_owned(), vec![]),
            ("text_projection.weight".to_owned(), vec![self.projection, text]),
            ("visual_projection.weight".to_owned(), vec![self.projection, vision]),
            ("text_model.embeddings.token_embedding.weight".to_owned(), vec![self.vocab, text]),
            ("text_model.embeddings.position_embedding.weight".to_owned(), vec![self.positions, text]),
            ("vision_model.embeddings.class_embedding".to_owned(), vec![vision]),
            ("vision_model.embeddings.patch_embedding.weight".to_owned(), vec![vision, 3, self.patch, self.patch]),
            ("vision_model.embeddings.position_embedding.weight".to_owned(), vec![self.patches + 1, vision]),
        ];
        let mut pair = |name: String, shape: &[usize]| {
            all.push((format!("{name}.weight"), shape.to_vec()));
            all.push((format!("{name}.bias"), shape[..1].to_vec()));
        };
        pair("text_model.final_layer_norm".to_owned(), &[text]);
        pair("vision_model.pre_layrnorm".to_owned(), &[vision]);
        pair("vision_model.post_layernorm".to_owned(), &[vision]);
        for (name, tower) in [("text_model", &self.text), ("vision_model", &self.vision)] {
            for layer in 0..tower.layers {
                let prefix = format!("{name}.encoder.layers.{layer}");
                for norm in ["layer_norm1", "layer_norm2"] {
                    pair(format!("{prefix}.{norm}"), &[tower.width]);
                }
                for part in ["q_proj", "k_proj", "v_proj", "out_proj"] {
                    pair(format!("{prefix}.self_attn.{part}"), &[tower.width, tower.width]);
                }
                pair(format!("{prefix}.mlp.fc1"), &[tower.inner, tower.width]);
                pair(format!("{prefix}.mlp.fc2"), &[tower.width, tower.inner]);
            }
        }
        all
    }
}

/// `[B, 3, S, S]` planes as `[B, S, S, 4]` pixels.
fn pixels_of(planes: &[f32], side: usize) -> Vec<f32> {
    let area = side * side;
    let mut pixels = vec![0.0; planes.len() / 3 * 4];
    for (i, value) in planes.iter().enumerate() {
        let (image, channel, at) = (i / (3 * area), i / area % 3, i % area);
        pixels[(image * area + at) * 4 + channel] = *value;
    }
    pixels
}

fn length(x: &[f32]) -> f32 {
    x.iter().map(|v| v * v).sum::<f32>().sqrt()
}

fn token_ids(file: &TensorFile, name: &str) -> Vec<u32> {
    match &file.get(name).expect("token ids").values {
        Values::U32(ids) => ids.clone(),
        Values::I64(ids) => ids.iter().map(|id| u32::try_from(*id).expect("ids are not negative")).collect(),
        Values::F32(_) => panic!("{name} holds integers"),
    }
}

/// Token sequences of 77 places each, without what comes after the end token.
fn padded_texts(file: &TensorFile, name: &str, end: u32) -> Vec<Vec<u32>> {
    let texts = token_ids(file, name);
    let cut = |row: &[u32]| row[..=row.iter().position(|id| *id == end).expect("every text ends")].to_vec();
    texts.chunks_exact(77).map(cut).collect()
}
