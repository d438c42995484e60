//! Whose mark the embedding rows write.

use std::sync::OnceLock;

use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::watermark::key::owner_key::Key;
use guard4d_kernels::Device;

/// Message bits.
pub(crate) const BITS: u32 = 16;

const SECRET: [u8; 32] = [7; 32];

/// An owner, made when the first row needs one and the same for all: half a minute that other rows do not have to wait
/// for.
pub(crate) struct Owner {
    pub(crate) key: Key,
    pub(crate) message: Message,
}

impl Owner {
    /// The owner, with a key for this CLIP; every row embeds through the same.
    pub(crate) fn get(device: &Device, clip: &ClipModel) -> Result<&'static Self, EngineError> {
        static OWNER: OnceLock<Owner> = OnceLock::new();
        if let Some(owner) = OWNER.get() {
            return Ok(owner);
        }
        let (key, _) = Key::generate(device, clip, MasterSecret::from_bytes(SECRET), BITS)?;
        Ok(OWNER.get_or_init(|| Self { message: key.own_message(), key }))
    }
}
