//! Checkpoints of LPIPS that must be refused.

use std::path::Path;

use guard4d_engine::base::tensor_file::Tensor;
use guard4d_engine::networks::lpips::LpipsWeights;

use crate::support::random_lpips;

#[test]
fn checkpoints_must_be_complete_and_finite() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("lpips.safetensors");
    let refused = |change: &dyn Fn(&mut std::collections::BTreeMap<String, Tensor>)| {
        let mut file = random_lpips::weights();
        change(&mut file.tensors);
        std::fs::write(&path, file.to_bytes().expect("serialises")).expect("writable");
        let error = LpipsWeights::read(&path).expect_err("refused");
        assert_eq!(error.exit_code(), 65, "{error}");
        error.to_string()
    };
    let missing = refused(&|tensors| {
        tensors.remove("lin3.model.1.weight");
    });
    assert!(missing.contains("lin3.model.1.weight"), "{missing}");
    let shape = refused(&|tensors| {
        tensors.insert("features.6.bias".to_owned(), Tensor::f32(&[2], vec![0.0; 2]));
    });
    assert!(shape.contains("features.6.bias") && shape.contains("[384]"), "{shape}");
    let stranger = refused(&|tensors| {
        tensors.insert("features.2.weight".to_owned(), Tensor::f32(&[1], vec![0.0]));
    });
    assert!(stranger.contains("features.2.weight"), "{stranger}");
    let nan = refused(&|tensors| {
        tensors.insert("features.0.bias".to_owned(), Tensor::f32(&[64], vec![f32::NAN; 64]));
    });
    assert!(nan.contains("features.0.bias") && nan.contains("NaN"), "{nan}");
    let missing = LpipsWeights::read(Path::new("nowhere.safetensors")).expect_err("missing");
    assert_eq!(missing.exit_code(), 66, "{missing}");
}
