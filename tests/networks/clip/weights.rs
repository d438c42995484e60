//! Checkpoints with missing, unexpected or misshapen tensors.

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};

use super::{Dims, Tower};
use crate::support::gpu::{Gpu, device};
use crate::support::repo;

const CONFIG: &[u8] = br#"{
    "projection_dim": 8,
    "text_config": {"vocab_size": 5, "hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1,
                    "num_attention_heads": 2, "max_position_embeddings": 4},
    "vision_config": {"hidden_size": 8, "intermediate_size": 16, "num_hidden_layers": 1, "num_attention_heads": 1,
                      "image_size": 4, "patch_size": 2}
}"#;

const DIMS: Dims = Dims {
    projection: 8,
    vocab: 5,
    positions: 4,
    text: Tower { width: 8, inner: 8, layers: 1 },
    vision: Tower { width: 8, inner: 16, layers: 1 },
    patch: 2,
    patches: 4,
};

/// A complete checkpoint for [`CONFIG`], all zeros.
fn complete() -> TensorFile {
    let zeros = |(name, shape): (String, Vec<usize>)| {
        let len = shape.iter().product();
        (name, Tensor::f32(&shape, vec![0.0; len]))
    };
    TensorFile { tensors: DIMS.tensors().into_iter().map(zeros).collect(), ..TensorFile::default() }
}

fn load(gpu: &Gpu, config: &[u8], file: &TensorFile) -> Result<ClipModel, EngineError> {
    let weights = file.to_bytes().expect("serialises");
    ClipModel::load(gpu, &ClipSource::Bytes { config, weights: &weights })
}

/// Field, found and expected of the refusal.
fn refusal(gpu: &Gpu, file: &TensorFile) -> [String; 3] {
    match load(gpu, CONFIG, file) {
        Err(EngineError::BadData { field, got, expected, .. }) => [field, got, expected],
        other => panic!("must be refused as bad data: {other:?}"),
    }
}

#[test]
fn a_complete_checkpoint_loads_with_and_without_position_ids() {
    let Some(gpu) = device() else { return };
    let mut file = complete();
    let plain = load(&gpu, CONFIG, &file).expect("complete").hash();
    file.tensors.insert("text_model.embeddings.position_ids".to_owned(), Tensor::u32(&[1, 4], vec![0, 1, 2, 3]));
    let carried = load(&gpu, CONFIG, &file).expect("position ids are carried by some versions").hash();
    assert_ne!(plain, carried, "the hash covers the file");
}

#[test]
fn missing_unexpected_and_misshapen_tensors_are_named() {
    let Some(gpu) = device() else { return };
    let key = "vision_model.encoder.layers.0.mlp.fc1.weight";
    let mut file = complete();
    file.tensors.remove(key);
    assert_eq!(refusal(&gpu, &file), [key, "no such tensor", "[16, 8]"], "missing");
    file.tensors.insert(key.to_owned(), Tensor::f32(&[8, 16], vec![0.0; 128]));
    assert_eq!(refusal(&gpu, &file), [key, "[8, 16]", "[16, 8]"], "transposed");
    file.tensors.insert(key.to_owned(), Tensor::u32(&[16, 8], vec![0; 128]));
    assert_eq!(refusal(&gpu, &file)[0], key, "integers");
    let mut file = complete();
    file.tensors.insert("extra.weight".to_owned(), Tensor::f32(&[1], vec![0.0]));
    assert_eq!(refusal(&gpu, &file)[0], "extra.weight", "unexpected");
}

#[test]
fn odd_configurations_are_refused_by_field() {
    let Some(gpu) = device() else { return };
    let text = std::str::from_utf8(CONFIG).expect("ASCII");
    for (from, to, field) in [
        ("\"hidden_size\": 8", "\"hidden_size\": 12", "text_config.hidden_size"),
        ("\"num_attention_heads\": 1", "\"num_attention_heads\": 3", "vision_config.num_attention_heads"),
        ("\"patch_size\": 2", "\"patch_size\": 5", "vision_config.patch_size"),
        ("\"patch_size\": 2", "\"patch_size\": 2, \"hidden_act\": \"swish\"", "vision_config.hidden_act"),
        ("\"vocab_size\": 5", "\"vocab_size\": \"five\"", "config"),
    ] {
        let changed = text.replacen(from, to, 1);
        match load(&gpu, changed.as_bytes(), &complete()) {
            Err(EngineError::BadData { field: named, .. }) => assert_eq!(named, field, "{to}"),
            other => panic!("{to} must be refused: {other:?}"),
        }
    }
}

#[test]
fn the_folder_and_the_embedded_copy_are_the_same_checkpoint() {
    let Some(gpu) = device() else { return };
    let folder = ClipModel::load(&gpu, &ClipSource::Dir(repo("engine/assets/mini-clip"))).expect("loads");
    assert_eq!(folder.hash(), ClipModel::load(&gpu, &ClipSource::Mini).expect("loads").hash(), "hash");
    let missing = ClipModel::load(&gpu, &ClipSource::Dir(repo("no such folder")));
    assert!(matches!(missing, Err(EngineError::MissingInput { .. })), "{missing:?}");
}
