//! ViT-B/32-shaped towers with formula weights against transformers; see `tests/golden/README.md`.
//!
//! A tensor's values depend on its name and place alone, so each tower is tried beside a tiny other one.

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::networks::clip::{ClipModel, ClipSource, TowerPurpose};

use super::super::{Dims, Tower, length, padded_texts, pixels_of};
use crate::support::close::{assert_close, assert_features_close, cosine};
use crate::support::gpu::device;
use crate::support::repo;

/// The image tower beside a tiny text tower.
const IMAGES: (&[u8], Dims) = (
    br#"{
        "projection_dim": 512,
        "text_config": {"vocab_size": 8, "hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1,
                        "num_attention_heads": 1, "max_position_embeddings": 4, "bos_token_id": 6, "eos_token_id": 7},
        "vision_config": {}
    }"#,
    Dims {
        projection: 512,
        vocab: 8,
        positions: 4,
        text: Tower { width: 8, inner: 8, layers: 1 },
        vision: Tower { width: 768, inner: 3072, layers: 12 },
        patch: 32,
        patches: 49,
    },
);

/// The text tower, which knows 64 tokens, beside a tiny image tower.
const TEXTS: (&[u8], Dims) = (
    br#"{
        "projection_dim": 512,
        "text_config": {"vocab_size": 64, "bos_token_id": 62, "eos_token_id": 63},
        "vision_config": {"hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1, "num_attention_heads": 1,
                          "image_size": 4, "patch_size": 2}
    }"#,
    Dims {
        projection: 512,
        vocab: 64,
        positions: 77,
        text: Tower { width: 512, inner: 2048, layers: 12 },
        vision: Tower { width: 8, inner: 8, layers: 1 },
        patch: 2,
        patches: 4,
    },
);

const BATCH: usize = 2;
const SIDE: usize = 224;

/// `count` values in [-1, 1) that depend on the name alone.
fn formula(name: &str, count: usize) -> impl Iterator<Item = f64> {
    let fnv = |seed: u32, byte: u8| (seed ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    let seed = name.bytes().fold(0x811c_9dc5, fnv);
    (0..count as u32).map(move |i| {
        let mut x = i.wrapping_mul(0x9e37_79b1).wrapping_add(seed);
        x ^= x >> 16;
        x = x.wrapping_mul(0x85eb_ca6b);
        x ^= x >> 13;
        x = x.wrapping_mul(0xc2b2_ae35);
        x ^= x >> 16;
        f64::from(x >> 8) / f64::from(1u32 << 23) - 1.0
    })
}

fn scaled(name: &str, count: usize, scale: f64, shift: f64) -> Vec<f32> {
    formula(name, count).map(|u| (shift + scale * u) as f32).collect()
}

fn weight(name: &str, shape: &[usize]) -> Tensor {
    let count = shape.iter().product();
    let norm = name.contains("norm");
    let table = name.contains("position") || name.contains("token");
    let values = if norm && name.ends_with(".weight") {
        scaled(name, count, 0.1, 1.0)
    } else if shape.len() >= 2 && !table {
        scaled(name, count, (3.0 / shape[1..].iter().product::<usize>() as f64).sqrt(), 0.0)
    } else {
        scaled(name, count, 0.1, 0.0)
    };
    Tensor::f32(shape, values)
}

fn clip(gpu: &guard4d_kernels::Device, (config, dims): (&[u8], Dims)) -> ClipModel {
    let tensors = dims.tensors().into_iter().map(|(name, shape)| {
        let tensor = weight(&name, &shape);
        (name, tensor)
    });
    let file = TensorFile { tensors: tensors.collect(), ..TensorFile::default() };
    let weights = file.to_bytes().expect("serialises");
    ClipModel::load(gpu, &ClipSource::Bytes { config, weights: &weights }).expect("complete")
}

fn golden() -> TensorFile {
    TensorFile::read(&repo("tests/golden/clip_vit_b32.safetensors")).expect("golden values")
}

#[test]
fn features_and_pixel_gradients_match_transformers() {
    let Some(gpu) = device() else { return };
    let tower = clip(&gpu, IMAGES).vision(TowerPurpose::InputGradient).expect("tower");
    let planes = scaled("pixel_values", BATCH * 3 * SIDE * SIDE, 2.0, 0.0);
    let pixels = gpu.buffer_from("pixels", &pixels_of(&planes, SIDE)).expect("buffer");
    let v_features = gpu.buffer_from("v_features", &scaled("v_features", BATCH * 512, 1.0, 0.0)).expect("buffer");
    let mut v_pixels = gpu.buffer::<f32>("v_pixels", BATCH * SIDE * SIDE * 4).expect("buffer");
    let mut ws = tower.workspace(BATCH).expect("workspace");
    let mut rec = gpu.recorder().expect("recorder");
    tower.forward(&mut rec, &pixels, &mut ws).expect("records");
    tower.backward(&mut rec, &v_features, &mut ws, &mut v_pixels).expect("records");
    rec.submit().expect("runs");

    let golden = golden();
    let floats = |name: &str, shape: &[usize]| golden.floats(name, shape).expect("golden tensor").to_vec();
    assert_features_close(&ws.embeds.read().expect("read"), &floats("embeds", &[BATCH, 512]), 512);
    assert_features_close(&ws.features.read().expect("read"), &floats("features", &[BATCH, 512]), 512);
    let v_pixels = v_pixels.read().expect("read");
    let kept = floats("v_pixels_kept", &[BATCH, 3, 32, 32]);
    let lengths = floats("v_pixels_norm", &[BATCH]);
    for (image, gradient) in v_pixels.chunks_exact(SIDE * SIDE * 4).enumerate() {
        // The gradient's length is a sum of 150,528 squares; its rounding is far below 1e-3.
        assert_close(&[length(gradient)], &[lengths[image]], 0.0, 1e-3);
        let place = |i: usize| ((3 + i / 32 % 32 * 7) * SIDE + 5 + i % 32 * 7) * 4 + i / 1024;
        let got: Vec<f32> = (0..3 * 1024).map(|i| gradient[place(i)]).collect();
        let similar = cosine(&got, &kept[image * 3 * 1024..][..3 * 1024]);
        assert!(similar > 0.9999, "image {image}: cosine {similar}");
    }
}

#[test]
fn text_features_match_transformers() {
    let Some(gpu) = device() else { return };
    let tower = clip(&gpu, TEXTS).text().expect("tower");
    let golden = golden();
    let want = golden.floats("text_features", &[2, 512]).expect("golden tensor");
    let embeds = golden.floats("text_embeds", &[2, 512]).expect("golden tensor");
    let texts = padded_texts(&golden, "input_ids", tower.config().begin_and_end().1);
    for ((text, want), embeds) in texts.iter().zip(want.chunks_exact(512)).zip(embeds.chunks_exact(512)) {
        let got = tower.embed(text, text.len()).expect("embeds");
        assert_features_close(&got.embeds, embeds, 512);
        assert_features_close(&got.features, want, 512);
    }
    assert_eq!(texts.iter().map(Vec::len).collect::<Vec<_>>(), [18, 50], "two lengths");
}
