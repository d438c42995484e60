//! Owner key: master secret, token table and the frozen message decoder, bound to one CLIP checkpoint.
//!
//! Every asset has a key of its own, made from the owner's: the same token table and decoder, which take training, and
//! another secret, from which its message, its rotation and all random draws follow. So a dispute over one asset can be
//! settled with that asset's key, and the others stay as secret as before.

use std::path::PathBuf;

use guard4d_kernels::Device;

use super::capacity::{self, Spectrum};
use super::decoder::DecoderWeights;
use super::decoder_training::{DecoderTraining, Trainer};
use super::text_codes::{CodeMessages, TextCodes};
use super::tokens::{TokenTable, Vocabulary};
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::base::prf::{MasterSecret, Prf, Purpose};
use crate::base::signature::{PublicKey, SigningKey};
use crate::error::EngineError;
use crate::evidence::message::Message;
use crate::evidence::payload::Payload;
use crate::networks::clip::ClipModel;

/// Messages the decoder is trained on (method: at least 20,000).
const TRAINING_MESSAGES: usize = 20_480;
/// Messages it is tested on, never trained on.
const HELD_OUT_MESSAGES: usize = 4_096;

/// Furthest that codes measured again may be from those of a key file, as a share. Keys are made in single precision
/// whatever precision films are read in; devices then differ by some 1e-6.
const CODES_TOLERANCE: f64 = 1e-4;
/// Share of the messages in which a decoder has to read each bit right. One that prints a bit whatever it is shown is
/// right in half of them; trained ones are right in all but a few of ten thousand.
const LEAST_BIT_ACCURACY: f64 = 0.75;

/// Everything an owner needs to embed and verify, or what belongs to one asset of it; private.
#[derive(Clone, Debug)]
pub struct Key {
    pub(super) scope: Scope,
    /// What table, codes and the decoder's start follow from.
    pub(super) reader: MasterSecret,
    /// Bit-to-token table.
    pub table: TokenTable,
    /// Frozen decoder.
    pub decoder: DecoderWeights,
    /// Mean text feature `[width]`, towards which image features are moved.
    pub text_mean: Vec<f32>,
    /// Half the change of the text feature when a bit flips `[bits, width]`.
    pub codes: Vec<f32>,
    /// Checkpoint it was made with.
    pub clip: Digest,
    /// Where it was read from; named in errors.
    pub(super) path: PathBuf,
}

/// What a key is for.
#[derive(Clone, Debug)]
pub(super) enum Scope {
    /// All of an owner's assets. One key file of the first version, whose secret every receipt of then used as it is.
    First(MasterSecret),
    /// All of an owner's assets.
    Owner(MasterSecret),
    /// One asset.
    Asset {
        /// Hash of the unmarked asset.
        asset: Digest,
        secret: MasterSecret,
        signer: Signer,
    },
}

/// Who signs an asset's receipts.
#[derive(Clone, Debug)]
pub(super) enum Signer {
    /// The owner, whose key this is from.
    Own(SigningKey),
    /// The owner, who disclosed this key.
    Other(PublicKey),
}

/// What `keygen` reports.
#[derive(Clone, Debug, serde::Serialize)]
pub struct KeyReport {
    /// Public name of the key.
    pub key_id: String,
    /// Message bits.
    pub bits: usize,
    /// Singular values of the message features.
    pub spectrum: Spectrum,
    /// Share of held-out bits that the decoder reads.
    pub held_out_accuracy: f64,
    /// Held-out messages read without any error.
    pub held_out_exact: f64,
    /// Seconds for features and training.
    pub seconds: f64,
}

impl Key {
    /// Derives a key from `secret` and trains its decoder.
    ///
    /// # Equation: Guard4D Sec. 3.2
    /// # Determinism: same secret, checkpoint, device and driver give the same key
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a length that is no multiple of 8 or that the vocabulary cannot hold;
    /// [`EngineError::BadData`] when the checkpoint cannot carry so many bits.
    pub fn generate(
        device: &Device,
        clip: &ClipModel,
        secret: MasterSecret,
        bits: u32,
    ) -> Result<(Self, KeyReport), EngineError> {
        let started = std::time::Instant::now();
        let vocabulary = vocabulary(clip);
        if !(bits.is_multiple_of(8) && vocabulary.holds(bits)) {
            return Err(vocabulary.refusal(bits, "a multiple of 8, "));
        }
        let mut key = Self::untrained(clip, secret, bits)?;
        let prf = Prf::new(&key.reader);
        let table = &key.table;
        let messages = draw_messages(&prf, bits)?;
        let (features, spectrum) = text_features(clip, table, &messages)?;
        let width = clip.config().projection_dim;
        let (train, held_out) = features.split_at(TRAINING_MESSAGES * width);
        let targets: Vec<f32> =
            messages[..TRAINING_MESSAGES].iter().flat_map(Message::bits).map(|b| f32::from(u8::from(b))).collect();
        let features = device.buffer_from("key.features", train)?;
        let targets = device.buffer_from("key.targets", &targets)?;
        let mut init = prf.stream(Purpose::DecoderInit, 0);
        let training = DecoderTraining::for_bits(bits as usize);
        let mut trainer = Trainer::new(device, width, bits as usize, training, &mut init)?;
        trainer.run(device, &features, &targets)?;
        key.decoder = trainer.weights()?;

        let reading = capacity::read_held_out(device, &key.decoder, held_out, &messages[TRAINING_MESSAGES..])?;
        capacity::check_reading(&reading, bits as usize, clip.path())?;
        let report = KeyReport {
            key_id: key.prf().key_id().to_string(),
            bits: bits as usize,
            spectrum,
            held_out_accuracy: reading.bit_accuracy,
            held_out_exact: reading.exact,
            seconds: started.elapsed().as_secs_f64(),
        };
        Ok((key, report))
    }

    /// The part of a key that needs no training: its decoder is one of zeros, which reads nothing.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a length that the vocabulary cannot hold; when the device fails.
    pub fn untrained(clip: &ClipModel, secret: MasterSecret, bits: u32) -> Result<Self, EngineError> {
        let reader = reader_secret(&secret);
        let prf = Prf::new(&reader);
        let table = TokenTable::derive(&prf, vocabulary(clip), bits)?;
        let TextCodes { mean: text_mean, codes } = CodeMessages::embed(clip, &table, &prf)?.codes();
        Ok(Self {
            decoder: DecoderWeights::zeros(text_mean.len(), bits as usize),
            scope: Scope::Owner(secret),
            reader,
            table,
            text_mean,
            codes,
            clip: digest_of(clip),
            path: PathBuf::from("new key"),
        })
    }

    /// The key of one asset, by the hash of the unmarked model ([`crate::scene::Model::digest`]).
    ///
    /// # Errors
    /// [`EngineError::BadData`] for another asset than the one that a disclosed key is for, and for a key of the first
    /// version, which has no keys of assets.
    pub fn for_asset(&self, asset: Digest) -> Result<Self, EngineError> {
        let secret = match &self.scope {
            Scope::Owner(secret) => secret,
            Scope::Asset { asset: own, .. } if *own == asset => return Ok(self.clone()),
            Scope::Asset { asset: own, .. } => {
                return Err(bad_data(&self.path, "asset", own, format!("{asset}, the asset in question")));
            }
            Scope::First(_) => {
                let expected =
                    format!("{}, as `keygen` makes them; older keys read older receipts alone", Self::FORMAT);
                return Err(bad_data(&self.path, "format", Self::FIRST_FORMAT, expected));
            }
        };
        let scope = Scope::Asset {
            asset,
            secret: Prf::new(secret).secret(Purpose::AssetSecret, asset.as_bytes()),
            signer: Signer::Own(signing_key(secret)),
        };
        Ok(Self { scope, ..self.clone() })
    }

    /// The asset that it is the key of; none for an owner's key of all.
    #[must_use]
    pub fn asset(&self) -> Option<Digest> {
        match self.scope {
            Scope::First(_) | Scope::Owner(_) => None,
            Scope::Asset { asset, .. } => Some(asset),
        }
    }

    /// The pseudo-random function of the owner, or of the asset if it is an asset's key.
    #[must_use]
    pub fn prf(&self) -> Prf {
        match &self.scope {
            Scope::First(secret) | Scope::Owner(secret) | Scope::Asset { secret, .. } => Prf::new(secret),
        }
    }

    /// What signs receipts; none in a disclosed key.
    #[must_use]
    pub fn signing_key(&self) -> Option<SigningKey> {
        match &self.scope {
            Scope::First(secret) | Scope::Owner(secret) => Some(signing_key(secret)),
            Scope::Asset { signer: Signer::Own(signing_key), .. } => Some(signing_key.clone()),
            Scope::Asset { signer: Signer::Other(_), .. } => None,
        }
    }

    /// What the owner's signatures are checked with.
    #[must_use]
    pub fn public_key(&self) -> PublicKey {
        match &self.scope {
            Scope::First(secret) | Scope::Owner(secret) => signing_key(secret).public_key(),
            Scope::Asset { signer: Signer::Own(signing_key), .. } => signing_key.public_key(),
            Scope::Asset { signer: Signer::Other(public_key), .. } => *public_key,
        }
    }

    /// Where the bits' text features lie, as the key file says.
    #[must_use]
    pub fn text_codes(&self) -> TextCodes {
        TextCodes { mean: self.text_mean.clone(), codes: self.codes.clone() }
    }

    /// Measures again what follows from the secret and CLIP, and refuses a key that says otherwise: nothing of the file
    /// is taken at its word but what was trained. Of that the decoder, which a receipt commits to, has to read the
    /// messages' text features.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming what does not follow; when the device fails.
    pub fn check(&self, device: &Device, clip: &ClipModel) -> Result<(), EngineError> {
        let sample = CodeMessages::embed(clip, &self.table, &Prf::new(&self.reader))?;
        let deviation = self.text_codes().deviation(&sample.codes());
        // A NaN is further than any bound.
        if deviation.is_nan() || deviation > CODES_TOLERANCE {
            let got = format!("values {deviation:.1e} of their size away from what secret and CLIP give");
            let expected = format!("at most {CODES_TOLERANCE:e}, which arithmetic explains");
            return Err(bad_data(&self.path, "text_mean or codes", got, expected));
        }
        let shares = capacity::read_bits(device, &self.decoder, &sample.features, &sample.messages)?;
        match shares.iter().position(|share| *share < LEAST_BIT_ACCURACY || share.is_nan()) {
            None => Ok(()),
            Some(bit) => {
                let got = format!("one that reads bit {bit} right in {:.0} % of messages", 100.0 * shares[bit]);
                let expected = format!("{:.0} %: it does not read, it recites", 100.0 * LEAST_BIT_ACCURACY);
                Err(bad_data(&self.path, "decoder", got, format!("at least {expected}")))
            }
        }
    }

    /// Message bits.
    #[must_use]
    pub fn bits(&self) -> usize {
        self.table.num_bits()
    }

    /// Message bits, as messages count theirs.
    ///
    /// # Panics
    /// Never: tables are refused unless a message can have their length.
    #[must_use]
    pub fn num_bits(&self) -> u32 {
        u32::try_from(self.bits()).expect("tables are refused unless a message can have their length")
    }

    /// The message that this key alone decides: what `random` stands for. An asset's key has one of its own.
    ///
    /// # Panics
    /// Never: a table has as many rows as some message has bits.
    #[must_use]
    pub fn own_message(&self) -> Message {
        let own = Payload::Random(self.num_bits()).message(&self.prf());
        own.expect("tables are refused unless a message can have their length")
    }

    /// Hash of the decoder's weights, for receipts.
    #[must_use]
    pub fn decoder_digest(&self) -> Digest {
        let mut bytes = Vec::new();
        for layer in &self.decoder.layers {
            bytes.extend_from_slice(bytemuck::cast_slice(&layer.weight));
            bytes.extend_from_slice(bytemuck::cast_slice(&layer.bias));
        }
        Digest::of(&bytes)
    }
}

impl Key {
    /// `format` entry of a key file.
    pub const FORMAT: &str = "guard4d.key/2";
    /// The same of the first version.
    pub(super) const FIRST_FORMAT: &str = "guard4d.key/1";
}

/// What an owner's token table and decoder follow from. It is apart from the secrets of assets, so that one can be
/// disclosed with it.
pub(super) fn reader_secret(owner: &MasterSecret) -> MasterSecret {
    Prf::new(owner).secret(Purpose::ReaderSecret, &[])
}

fn signing_key(owner: &MasterSecret) -> SigningKey {
    SigningKey::from_seed(Prf::new(owner).secret(Purpose::SigningSeed, &[]).expose())
}

/// A checkpoint's hash as receipts and keys write it.
#[must_use]
pub fn digest_of(clip: &ClipModel) -> Digest {
    Digest::from_bytes(*clip.hash().as_bytes())
}

#[allow(clippy::cast_possible_truncation, reason = "token ids are 32-bit")]
pub(super) fn vocabulary(clip: &ClipModel) -> Vocabulary {
    let text = &clip.config().text_config;
    Vocabulary { size: text.vocab_size as u32, context: text.max_position_embeddings as u32 }
}

/// Text features of all messages, and their spectrum. A checkpoint that cannot carry them is refused after the first
/// few, for a large text tower takes long over all.
fn text_features(
    clip: &ClipModel,
    table: &TokenTable,
    messages: &[Message],
) -> Result<(Vec<f32>, Spectrum), EngineError> {
    let (tower, tokens) = (clip.text()?, table.num_bits() + 2);
    let width = clip.config().projection_dim;
    let embed = |messages: &[Message]| {
        // Short messages are drawn again and again: 8 bits have 256 of them.
        let (mut seen, mut sequences) = (std::collections::HashMap::new(), Vec::new());
        for message in messages {
            if !seen.contains_key(message) {
                seen.insert(*message, seen.len());
                sequences.extend(table.sequence(message)?);
            }
        }
        let distinct = tower.embed(&sequences, tokens)?.features;
        let row = |message: &Message| &distinct[seen[message] * width..][..width];
        Ok::<_, EngineError>(messages.iter().flat_map(row).copied().collect::<Vec<f32>>())
    };
    let (first, rest) = messages.split_at(capacity::SPECTRUM_ROWS);
    let mut features = embed(first)?;
    let spectrum = capacity::spectrum(&features, width, clip.path())?;
    capacity::check_spectrum(&spectrum, table.num_bits(), clip.path())?;
    features.extend(embed(rest)?);
    Ok((features, spectrum))
}

/// Training messages, then held-out ones; no message is in both parts.
fn draw_messages(prf: &Prf, bits: u32) -> Result<Vec<Message>, EngineError> {
    let mut rng = prf.stream(Purpose::DecoderTraining, 0);
    let mut messages =
        (0..TRAINING_MESSAGES).map(|_| Message::random(bits, &mut rng)).collect::<Result<Vec<_>, _>>()?;
    let seen: std::collections::HashSet<Message> = messages.iter().copied().collect();
    // 8-bit messages are all seen in training; then the held-out set can only repeat them.
    let all_seen = bits < 32 && seen.len() as u64 == 1 << bits;
    while messages.len() < TRAINING_MESSAGES + HELD_OUT_MESSAGES {
        let message = Message::random(bits, &mut rng)?;
        if all_seen || !seen.contains(&message) {
            messages.push(message);
        }
    }
    Ok(messages)
}
