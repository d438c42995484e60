//! An `AlexNet` for LPIPS with random weights, for tests that must not ask for a file that not every clone has.

use std::path::{Path, PathBuf};

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};

use super::random::Random;

/// Number, outputs, inputs and filter side of each layer.
const LAYERS: [(usize, usize, usize, usize); 5] =
    [(0, 64, 3, 11), (3, 192, 64, 5), (6, 384, 192, 3), (8, 256, 384, 3), (10, 256, 256, 3)];

/// The checkpoint; every layer keeps the size of its input.
pub(crate) fn weights() -> TensorFile {
    let mut file = TensorFile::default();
    let mut random = Random(77);
    for (tap, (index, outputs, inputs, taps)) in LAYERS.into_iter().enumerate() {
        let fan_in = inputs * taps * taps;
        let size = (6.0 / fan_in as f32).sqrt();
        let mut add = |name: String, shape: &[usize], (low, high): (f32, f32)| {
            let values = random.vec_f32(shape.iter().product(), low, high);
            file.tensors.insert(name, Tensor::f32(shape, values));
        };
        add(format!("features.{index}.weight"), &[outputs, inputs, taps, taps], (-size, size));
        add(format!("features.{index}.bias"), &[outputs], (-0.1, 0.1));
        add(format!("lin{tap}.model.1.weight"), &[1, outputs, 1, 1], (0.0, 0.1));
    }
    file
}

/// The checkpoint as a file in `folder`.
pub(crate) fn write(folder: &Path) -> PathBuf {
    let path = folder.join("lpips.safetensors");
    std::fs::write(&path, weights().to_bytes().expect("serialises")).expect("writable");
    path
}
