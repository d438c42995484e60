//! Keys as `keygen` makes them, with a decoder that is really trained; each is made once per process.

use std::sync::OnceLock;

use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::watermark::key::owner_key::Key;

use super::gpu::Gpu;

const SECRET: [u8; 32] = [42; 32];

/// The built-in CLIP.
pub(crate) fn clip(gpu: &Gpu) -> ClipModel {
    ClipModel::load(gpu, &ClipSource::Mini).expect("the built-in checkpoint is complete")
}

/// The key of 16 bits.
pub(crate) fn key_of_16(gpu: &Gpu, clip: &ClipModel) -> &'static Key {
    static KEY: OnceLock<Key> = OnceLock::new();
    KEY.get_or_init(|| trained(gpu, clip, 16))
}

/// The key of 32 bits.
pub(crate) fn key_of_32(gpu: &Gpu, clip: &ClipModel) -> &'static Key {
    static KEY: OnceLock<Key> = OnceLock::new();
    KEY.get_or_init(|| trained(gpu, clip, 32))
}

fn trained(gpu: &Gpu, clip: &ClipModel, bits: u32) -> Key {
    let secret = MasterSecret::from_bytes(SECRET);
    Key::generate(gpu, clip, secret, bits).expect("the built-in CLIP carries them").0
}
