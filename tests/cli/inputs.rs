//! Checkpoints, keys and messages that must be refused.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};

use super::{guard4d, names, put, scratch};
use crate::support::fixture::TinyModel;
use crate::support::gpu::device;
use crate::support::owner::{BITS, key_file};
use crate::support::repo;

#[test]
fn a_missing_model_is_a_missing_input() {
    let folder = scratch();
    let nowhere = folder.path().join("nowhere");
    let words = ["nowhere: not found", "a 4DGaussians folder, or splats as PLY", "missing_input"];
    guard4d(&[&"inspect", &nowhere]).refused(66, &words);
    guard4d(&[&"inspect", &folder.path()])
        .refused(66, &["*.ply", "a 4DGaussians folder, or one with a file of splats for each moment"]);
    let out = folder.path().join("out");
    if device().is_some() {
        guard4d(&[&"render", &nowhere, &"--out", &out]).refused(66, &words);
    }
    assert_eq!(names(folder.path()), [""; 0], "nothing is written");
}

/// The configuration of the embedded checkpoint, in a folder of its own.
fn clip_folder(folder: &Path, weights: Option<&TensorFile>) -> PathBuf {
    let config = fs::read(repo("engine/assets/mini-clip/config.json")).expect("it ships with the program");
    let clip = folder.join("clip");
    put(&clip, "config.json", &config);
    if let Some(weights) = weights {
        put(&clip, "model.safetensors", &weights.to_bytes().expect("serialises"));
    }
    clip
}

#[test]
fn wrong_checkpoints_are_refused() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("owner.key");
    let keygen = |clip: &Path| guard4d(&[&"keygen", &"--clip", &clip, &"--out", &out]);
    keygen(&folder.path().join("nowhere")).refused(66, &["config.json: not found", "a CLIP checkpoint"]);
    keygen(&clip_folder(folder.path(), None)).refused(66, &["model.safetensors: not found"]);
    let mut weights = TensorFile::default();
    weights.tensors.insert("logit_scale".to_owned(), Tensor::f32(&[], vec![1.0]));
    keygen(&clip_folder(folder.path(), Some(&weights))).refused(65, &["model.safetensors", "no such tensor"]);
    weights.tensors.insert("text_projection.weight".to_owned(), Tensor::f32(&[2, 2], vec![0.0; 4]));
    keygen(&clip_folder(folder.path(), Some(&weights))).refused(65, &["model.safetensors: text_"]);
    put(&folder.path().join("clip"), "config.json", b"[1, 2");
    keygen(&folder.path().join("clip")).refused(65, &["config.json"]);
    assert_eq!(names(folder.path()), ["clip"], "no key and no partial key");
}

/// A checkpoint that is good but for one tensor.
#[test]
fn checkpoints_with_one_wrong_tensor_are_refused() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("owner.key");
    let good = TensorFile::read(&repo("engine/assets/mini-clip/model.safetensors")).expect("it ships with the program");
    let name = "text_model.final_layer_norm.weight";
    let width = good.get(name).expect("a tensor").shape[0];
    let keygen = |words: &[&str], tensor: Option<Tensor>, name: &str| {
        let mut weights = good.clone();
        match tensor {
            Some(tensor) => weights.tensors.insert(name.to_owned(), tensor),
            None => weights.tensors.remove(name),
        };
        let clip = clip_folder(folder.path(), Some(&weights));
        let words = [&["model.safetensors", name, "expected"], words].concat();
        guard4d(&[&"keygen", &"--clip", &clip, &"--out", &out]).refused(65, &words);
    };
    keygen(&["no such tensor", &format!("[{width}]")], None, name);
    let longer = Tensor::f32(&[width + 1], vec![1.0; width + 1]);
    keygen(&[&format!("[{}], expected [{width}]", width + 1)], Some(longer), name);
    keygen(&["integers", "F32, F16 or BF16"], Some(Tensor::u32(&[width], vec![1; width])), name);
    let mut poisoned = vec![1.0; width];
    poisoned[2] = f32::NAN;
    keygen(&["NaN", "finite"], Some(Tensor::f32(&[width], poisoned)), name);
    keygen(&["no tensor of this name"], Some(Tensor::f32(&[1], vec![0.0])), "text_model.adapter");
    assert_eq!(names(folder.path()), ["clip"], "no key and no partial key");
}

#[test]
fn keys_of_other_checkpoints_and_long_messages_are_refused() {
    let Some(gpu) = device() else { return };
    let clip = ClipModel::load(&gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let folder = scratch();
    let model = TinyModel::new();
    let mut file = key_file(&clip);
    let good = put(folder.path(), "good.key", &file.to_bytes().expect("serialises"));
    file.meta.insert("clip".to_owned(), "0".repeat(64));
    let foreign = put(folder.path(), "foreign.key", &file.to_bytes().expect("serialises"));
    file.meta.insert("format".to_owned(), "other/1".to_owned());
    let other = put(folder.path(), "other.key", &file.to_bytes().expect("serialises"));
    let mut poisoned = key_file(&clip);
    let text_mean = poisoned.tensors.get_mut("text_mean").expect("a tensor of keys");
    let shape = text_mean.shape.clone();
    *text_mean = Tensor::f32(&shape, vec![f32::INFINITY; shape[0]]);
    let poisoned = put(folder.path(), "nan.key", &poisoned.to_bytes().expect("serialises"));
    let cut = put(folder.path(), "cut.key", &fs::read(&good).expect("readable")[..1000]);
    let out = folder.path().join("out");
    let embed = |key: &Path, message: &str| {
        guard4d(&[&"embed", &model.path(), &"--key", &key, &"--message", &message, &"--out", &out])
    };
    embed(&foreign, "random").refused(65, &["foreign.key: clip", "a key made with checkpoint 0000"]);
    embed(&other, "random").refused(65, &["other.key: format: other/1"]);
    embed(&poisoned, "random").refused(65, &["nan.key: text_mean: inf at element 0", "finite numbers"]);
    embed(&cut, "random").refused(65, &["cut.key: header"]);
    embed(&folder.path().join("none.key"), "random").refused(66, &["none.key: not found"]);
    let long = format!("bits:{}", "1".repeat(BITS as usize + 1));
    embed(&good, &long).refused(2, &["message: 9 digits", "8 digits 0 or 1 for a key of 8 bits"]);
    embed(&good, "hex:fff").refused(2, &["message: 3 digits", "2 hexadecimal digits"]);
    embed(&good, "hello").refused(2, &["`hello`", "`random`, `hex:…`, `bits:…`, `id:12:N` or `id:16:N`"]);
    assert_eq!(
        names(folder.path()),
        ["cut.key", "foreign.key", "good.key", "nan.key", "other.key"],
        "no output, whole or partial"
    );
}
