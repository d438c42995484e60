//! Everything secret or random derives from one master secret, by a keyed PRF.
//!
//! Nothing can then be fitted afterwards: whoever holds the secret can recompute the token table, the
//! decoder's starting point, the message and every training draw, and whoever lacks it can predict none.

use std::fmt;

use rand::TryRng;
use rand::rngs::SysRng;
use rand_chacha::ChaCha20Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use secrecy::{ExposeSecret as _, SecretBox};
use serde::{Deserialize, Serialize};
use zeroize::Zeroizing;

use super::digest::Digest;
use crate::error::EngineError;

/// BLAKE3 key-derivation context; a change of any derivation below needs a new one.
const CONTEXT: &str = "guard4d 2026 master secret to prf key, version 1";

/// 32 secret bytes: the owner's, from which all else follows, or some that follow from them. Their memory is wiped when
/// they are dropped.
pub struct MasterSecret(SecretBox<[u8; 32]>);

/// Fills bytes from the operating system's random source.
///
/// # Errors
/// [`EngineError::Program`] if the system has no working random source.
pub fn fill_unpredictably(bytes: &mut [u8]) -> Result<(), EngineError> {
    SysRng
        .try_fill_bytes(bytes)
        .map_err(|error| EngineError::Program { program: "system random source".to_owned(), reason: error.to_string() })
}

impl MasterSecret {
    /// Wraps 32 secret bytes, for instance those of a key file.
    #[must_use]
    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(SecretBox::new(Box::new(bytes)))
    }

    /// Draws a secret from the operating system's random source.
    ///
    /// # Errors
    /// [`EngineError::Program`] if the system has no working random source.
    pub fn generate() -> Result<Self, EngineError> {
        let mut bytes = Zeroizing::new([0; 32]);
        fill_unpredictably(&mut *bytes)?;
        Ok(Self::from_bytes(*bytes))
    }

    /// The secret bytes, for writing a key file.
    #[must_use]
    pub fn expose(&self) -> &[u8; 32] {
        self.0.expose_secret()
    }
}

impl Clone for MasterSecret {
    fn clone(&self) -> Self {
        Self::from_bytes(*self.expose())
    }
}

impl PartialEq for MasterSecret {
    fn eq(&self, other: &Self) -> bool {
        self.expose() == other.expose()
    }
}

impl Eq for MasterSecret {}

impl fmt::Debug for MasterSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("MasterSecret(hidden)")
    }
}

/// A public name for a key: it identifies the key and says nothing about its secret.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct KeyId(Digest);

impl fmt::Display for KeyId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// What a derived stream is for. Two purposes never share a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Purpose {
    /// Bit-to-token table.
    TokenTable,
    /// Message decoder's initial weights.
    DecoderInit,
    /// Messages and order of the decoder's training.
    DecoderTraining,
    /// The owner's message.
    Message,
    /// Pad that makes a chosen payload uniformly distributed.
    PayloadPad,
    /// Extractor's (TMSD) initial weights.
    TmsdInit,
    /// Views and times of the training clips.
    Views,
    /// Views and times of the clips that are measured and never trained on.
    HeldOutViews,
    /// Random offsets that the calibration is fitted to.
    Responses,
    /// Rotation that mixes the calibrated directions.
    Calibration,
    /// Order of the clips and strength of the noise in embedding.
    Embedding,
    /// Noise of the control branches.
    ControlNoise,
    /// Master secrets of the other keys that every claim is compared with.
    OtherKeys,
    /// Message of the second copy in a message swap.
    SwapMessage,
    /// Biases of the fingerprint's code.
    CodeBiases,
    /// Positions of that code which are the same in all copies, and their chips.
    SharedChips,
    /// Secrets of single copies, which their chips follow from.
    CopyChips,
    /// Chips by which an owner proves an asset from any camera.
    OwnerChips,
    /// What is published of an issue and its copies before they leave.
    Commitments,
    /// Scenes that a pretrained extractor is made from.
    Scenes,
    /// Secret that a key's token table and decoder follow from.
    ReaderSecret,
    /// Secrets of single assets.
    AssetSecret,
    /// Seed of the key that signs receipts.
    SigningSeed,
    /// Messages whose text features the bits' codes are measured on.
    CodeMessages,
    /// MAC over the embedded message.
    MessageMac,
    /// Public key identifier.
    KeyId,
}

impl Purpose {
    const fn label(self) -> &'static str {
        match self {
            Self::TokenTable => "token-table",
            Self::DecoderInit => "decoder-init",
            Self::DecoderTraining => "decoder-training",
            Self::Message => "message",
            Self::PayloadPad => "payload-pad",
            Self::TmsdInit => "tmsd-init",
            Self::Views => "views",
            Self::HeldOutViews => "held-out-views",
            Self::Responses => "responses",
            Self::Calibration => "calibration",
            Self::Embedding => "embedding",
            Self::ControlNoise => "control-noise",
            Self::OtherKeys => "other-keys",
            Self::SwapMessage => "swap-message",
            Self::CodeBiases => "code-biases",
            Self::SharedChips => "shared-chips",
            Self::CopyChips => "copy-chips",
            Self::OwnerChips => "owner-chips",
            Self::Commitments => "commitments",
            Self::Scenes => "scenes",
            Self::ReaderSecret => "reader-secret",
            Self::AssetSecret => "asset-secret",
            Self::SigningSeed => "signing-seed",
            Self::CodeMessages => "code-messages",
            Self::MessageMac => "message-mac",
            Self::KeyId => "key-id",
        }
    }
}

/// Keyed pseudo-random function of one master secret.
#[derive(Clone)]
pub struct Prf {
    key: Zeroizing<[u8; 32]>,
}

impl fmt::Debug for Prf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Prf({})", self.key_id())
    }
}

impl Prf {
    /// Derives the PRF's key from the master secret.
    #[must_use]
    pub fn new(secret: &MasterSecret) -> Self {
        Self { key: Zeroizing::new(blake3::derive_key(CONTEXT, secret.expose())) }
    }

    /// A random stream for one purpose; `index` separates streams of the same purpose.
    ///
    /// # Equation
    /// seed = BLAKE3 keyed(key, len(label) ‖ label ‖ index), then `ChaCha20` (Bernstein 2008).
    /// # Determinism
    /// The words are the same on every platform.
    #[must_use]
    pub fn stream(&self, purpose: Purpose, index: u64) -> ChaCha20Rng {
        ChaCha20Rng::from_seed(*self.mac(purpose, &index.to_le_bytes()).as_bytes())
    }

    /// A keyed MAC over `data`; purposes are domain-separated.
    #[must_use]
    pub fn mac(&self, purpose: Purpose, data: &[u8]) -> Digest {
        let label = purpose.label().as_bytes();
        let mut hasher = blake3::Hasher::new_keyed(&self.key);
        hasher.update(&(label.len() as u64).to_le_bytes());
        hasher.update(label);
        hasher.update(data);
        Digest::from_bytes(*hasher.finalize().as_bytes())
    }

    /// A secret for one purpose, which says nothing about this one or about others of that purpose.
    #[must_use]
    pub fn secret(&self, purpose: Purpose, data: &[u8]) -> MasterSecret {
        MasterSecret::from_bytes(*self.mac(purpose, data).as_bytes())
    }

    /// The key's public name.
    #[must_use]
    pub fn key_id(&self) -> KeyId {
        KeyId(self.mac(Purpose::KeyId, &[]))
    }
}

/// A uniform integer in `0..bound`, without modulo bias.
///
/// # Determinism
/// Defined here rather than by a library, so that a key's table never changes with a dependency.
///
/// # Panics
/// If `bound` is 0: there is no such integer.
pub fn uniform_below(rng: &mut impl Rng, bound: u32) -> u32 {
    assert!(bound > 0, "no integer lies below 0");
    let accepted = u32::MAX - u32::MAX % bound;
    let mut draw = rng.next_u32();
    while draw >= accepted {
        draw = rng.next_u32();
    }
    draw % bound
}

/// A uniform number in [0, 1) on a grid of 2⁻⁵³.
pub fn uniform_unit(rng: &mut impl Rng) -> f64 {
    const STEP: f64 = 1.0 / (1_u64 << 53) as f64;
    (rng.next_u64() >> 11) as f64 * STEP
}

/// A standard normal number by the Box–Muller transform (1958); one value per two draws.
///
/// # Determinism
/// Same bits for the same mathematical library; last bits may differ between platforms.
pub fn standard_normal(rng: &mut impl Rng) -> f64 {
    let radius = (-2.0 * (1.0 - uniform_unit(rng)).ln()).sqrt();
    radius * (std::f64::consts::TAU * uniform_unit(rng)).cos()
}
