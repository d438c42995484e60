//! Every reader of files, fed with bytes: by libFuzzer as they evolve, by the tests with damaged files of the corpus.

use std::path::Path;

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::release::dating::proof::Proof;
use guard4d_engine::release::dating::response::token_of;
use guard4d_engine::release::dating::root::Root;
use guard4d_engine::release::dating::token::Token;
use guard4d_engine::release::receipt::Receipt;
use guard4d_engine::scene::deformation::derive_config;
use guard4d_engine::scene::pth::PthContent;
use guard4d_engine::scene::warp::WarpWeights;
use guard4d_engine::scene::{CameraSet, DeformConfig, DeformationWeights, FrameSize, Model};

/// What reads bytes.
pub type Reader = fn(&[u8]);

/// All of them, by the names of their targets and of their folders in the corpus.
pub const READERS: [(&str, Reader); 13] = [
    ("cameras", cameras),
    ("cfg_args", cfg_args),
    ("colmap", colmap),
    ("dates", dates),
    ("glb", glb),
    ("ply", ply),
    ("pth", pth),
    ("receipt", receipt),
    ("sog", sog),
    ("splat", splat),
    ("splatv", splatv),
    ("spz", spz),
    ("tensors", tensors),
];

/// Camera files as JSON.
pub fn cameras(data: &[u8]) {
    let size = FrameSize::new(64, 48).expect("a size");
    let _ = CameraSet::parse(Path::new("transforms.json"), data, size);
}

/// `cfg_args`.
pub fn cfg_args(data: &[u8]) {
    let _ = DeformConfig::parse(Path::new("cfg_args"), data);
}

/// COLMAP's binary files: the first byte says what share of the others are cameras.
pub fn colmap(data: &[u8]) {
    let Some((share, rest)) = data.split_first() else { return };
    let (cameras, images) = rest.split_at(rest.len() * usize::from(*share) / 256);
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    std::fs::write(folder.path().join("cameras.bin"), cameras).expect("writable");
    std::fs::write(folder.path().join("images.bin"), images).expect("writable");
    let _ = CameraSet::open(folder.path(), FrameSize::new(64, 48).expect("a size"));
}

/// Responses and tokens of time-stamping authorities, roots and proofs.
pub fn dates(data: &[u8]) {
    let _ = token_of(Path::new("response.tsr"), data);
    let _ = Token::parse(Path::new("receipt.tst"), data);
    let _ = Root::parse(Path::new("root.json"), data);
    let _ = Proof::parse(Path::new("receipt.proof.json"), data);
}

/// glTF binaries.
pub fn glb(data: &[u8]) {
    let _ = Model::parse(Path::new("scene.glb"), data.to_vec());
}

/// PLY: binary and text, still and on paths, and packed ones.
pub fn ply(data: &[u8]) {
    let _ = Model::parse(Path::new("scene.ply"), data.to_vec());
}

/// State dicts, and the networks in them.
pub fn pth(data: &[u8]) {
    let path = Path::new("deformation.pth");
    let Ok(PthContent::StateDict(tensors)) = PthContent::parse(path, data) else { return };
    let _ = WarpWeights::from_state_dict(path, tensors.clone());
    if let Ok(config) = derive_config(path, &tensors) {
        let _ = DeformationWeights::from_state_dict(path, tensors, config);
    }
}

/// Receipts.
pub fn receipt(data: &[u8]) {
    if let Ok(receipt) = Receipt::parse(Path::new("receipt.json"), data) {
        let _ = receipt.verify_commitment(Path::new("receipt.json"));
    }
}

/// SOG.
pub fn sog(data: &[u8]) {
    let _ = Model::parse(Path::new("scene.sog"), data.to_vec());
}

/// .splat.
pub fn splat(data: &[u8]) {
    let _ = Model::parse(Path::new("scene.splat"), data.to_vec());
}

/// .splatv.
pub fn splatv(data: &[u8]) {
    let _ = Model::parse(Path::new("scene.splatv"), data.to_vec());
}

/// SPZ.
pub fn spz(data: &[u8]) {
    let _ = Model::parse(Path::new("scene.spz"), data.to_vec());
}

/// Keys, extractors and undo files, all safetensors.
pub fn tensors(data: &[u8]) {
    let _ = TensorFile::from_bytes(Path::new("owner.key"), data);
}
