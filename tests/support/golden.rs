//! Golden files of `tests/golden`.

use std::path::PathBuf;

use safetensors::SafeTensors;

use super::repo;

/// One file, read whole.
pub(crate) struct Golden(Vec<u8>);

impl Golden {
    /// `tests/golden/<name>.safetensors`
    pub(crate) fn load(name: &str) -> Self {
        let path = repo(&format!("tests/golden/{name}.safetensors"));
        Self(std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())))
    }

    fn tensors(&self) -> SafeTensors<'_> {
        SafeTensors::deserialize(&self.0).expect("golden files are valid safetensors")
    }

    /// An f32 tensor's values.
    pub(crate) fn f32(&self, name: &str) -> Vec<f32> {
        let tensors = self.tensors();
        let tensor = tensors.tensor(name).unwrap_or_else(|e| panic!("`{name}`: {e}"));
        assert_eq!(tensor.dtype(), safetensors::Dtype::F32, "`{name}` is f32");
        bytemuck::pod_collect_to_vec(tensor.data())
    }

    /// The same in f64.
    pub(crate) fn f64(&self, name: &str) -> Vec<f64> {
        self.f32(name).into_iter().map(f64::from).collect()
    }

    /// A tensor's shape.
    pub(crate) fn shape(&self, name: &str) -> Vec<usize> {
        self.tensors().tensor(name).unwrap_or_else(|e| panic!("`{name}`: {e}")).shape().to_vec()
    }
}

/// A small 4DGaussians model folder of `tests/golden/models` with its `expected.safetensors`.
pub(crate) fn model(name: &str) -> PathBuf {
    repo("tests/golden/models").join(name)
}
