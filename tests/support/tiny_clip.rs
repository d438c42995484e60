//! A random CLIP, small enough to make keys in a moment.

use std::path::{Path, PathBuf};

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};

use super::gpu::Gpu;
use super::random::Random;
use crate::networks::clip::{Dims, Tower};

pub(crate) const CONFIG: &[u8] = br#"{
    "projection_dim": 64,
    "text_config": {"vocab_size": 64, "hidden_size": 32, "intermediate_size": 32, "num_hidden_layers": 1,
                    "num_attention_heads": 2, "max_position_embeddings": 12},
    "vision_config": {"hidden_size": 8, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 1,
                      "image_size": 16, "patch_size": 8}
}"#;

/// Tensors of the tokens that messages are written in.
pub(crate) const TOKENS: &str = "text_model.embeddings.token_embedding.weight";

/// A complete checkpoint for [`CONFIG`]: norms change nothing, all else is random.
pub(crate) fn weights() -> TensorFile {
    let dims = Dims {
        projection: 64,
        vocab: 64,
        positions: 12,
        text: Tower { width: 32, inner: 32, layers: 1 },
        vision: Tower { width: 8, inner: 16, layers: 1 },
        patch: 8,
        patches: 4,
    };
    let mut random = Random(21);
    let mut fill = |(name, shape): (String, Vec<usize>)| {
        let len = shape.iter().product();
        let values = match name.as_str() {
            _ if name.contains("norm") => vec![if name.ends_with("weight") { 1.0 } else { 0.0 }; len],
            TOKENS => random.vec_f32(len, -1.0, 1.0),
            // The end token is to hear the others: what they say of a bit must not drown in what it says itself.
            _ if name.contains("v_proj.weight") || name.contains("out_proj.weight") => random.vec_f32(len, -1.5, 1.5),
            _ => random.vec_f32(len, -0.3, 0.3),
        };
        (name, Tensor::f32(&shape, values))
    };
    TensorFile { tensors: dims.tensors().into_iter().map(&mut fill).collect(), ..TensorFile::default() }
}

/// The checkpoint, loaded.
pub(crate) fn load(gpu: &Gpu, weights: &TensorFile) -> ClipModel {
    let bytes = weights.to_bytes().expect("serialises");
    ClipModel::load(gpu, &ClipSource::Bytes { config: CONFIG, weights: &bytes }).expect("a complete checkpoint")
}

/// The checkpoint as a folder of its own in `folder`.
pub(crate) fn write(folder: &Path, weights: &TensorFile) -> PathBuf {
    let clip = folder.join("tiny-clip");
    std::fs::create_dir_all(&clip).expect("writable");
    std::fs::write(clip.join("config.json"), CONFIG).expect("writable");
    let bytes = weights.to_bytes().expect("serialises");
    std::fs::write(clip.join("model.safetensors"), bytes).expect("writable");
    clip
}
