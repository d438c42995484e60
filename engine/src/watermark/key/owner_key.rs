//! Owner key: master secret, token table and the frozen message decoder, bound to one CLIP checkpoint.

use std::path::{Path, PathBuf};

use guard4d_kernels::Device;

use super::capacity::{self, Spectrum};
use super::decoder::DecoderWeights;
use super::decoder_training::{DecoderTraining, Trainer};
use super::tokens::{TokenTable, Vocabulary, bit_codes};
use crate::base::digest::Digest;
use crate::base::output::{AtomicFile, Existing};
use crate::base::prf::{MasterSecret, Prf, Purpose};
use crate::base::tensor_file::{Tensor, TensorFile};
use crate::error::EngineError;
use crate::evidence::message::Message;
use crate::evidence::payload::Payload;
use crate::networks::clip::ClipModel;

/// `format` entry of a key file.
const FORMAT: &str = "guard4d.key/1";
/// Entry with the hash of everything else in a key file.
const CONTENT: &str = "content";
/// Messages the decoder is trained on (method: at least 20,000).
const TRAINING_MESSAGES: usize = 20_480;
/// Messages it is tested on, never trained on.
const HELD_OUT_MESSAGES: usize = 4_096;

/// Everything an owner needs to embed and verify; private.
#[derive(Clone, Debug)]
pub struct Key {
    secret: MasterSecret,
    /// Bit-to-token table.
    pub table: TokenTable,
    /// Frozen decoder.
    pub decoder: DecoderWeights,
    /// Mean text feature of random messages `[width]`, towards which image features are moved.
    pub text_mean: Vec<f32>,
    /// Half the change of the text feature when a bit flips `[bits, width]`.
    pub codes: Vec<f32>,
    /// Checkpoint it was made with.
    pub clip: Digest,
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
        let prf = Prf::new(&secret);
        let table = TokenTable::derive(&prf, vocabulary, bits)?;
        let messages = draw_messages(&prf, bits)?;
        let (features, spectrum) = text_features(clip, &table, &messages)?;
        let width = clip.config().projection_dim;
        let (train, held_out) = features.split_at(TRAINING_MESSAGES * width);
        let text_mean = capacity::mean_row(train, width);
        let targets: Vec<f32> =
            messages[..TRAINING_MESSAGES].iter().flat_map(Message::bits).map(|b| f32::from(u8::from(b))).collect();
        let signs: Vec<f32> = targets.iter().map(|t| 2.0 * t - 1.0).collect();
        let codes = bit_codes(train, &signs, &text_mean, bits as usize);
        let features = device.buffer_from("key.features", train)?;
        let targets = device.buffer_from("key.targets", &targets)?;
        let mut init = prf.stream(Purpose::DecoderInit, 0);
        let training = DecoderTraining::for_bits(bits as usize);
        let mut trainer = Trainer::new(device, width, bits as usize, training, &mut init)?;
        trainer.run(device, &features, &targets)?;
        let decoder = trainer.weights()?;

        let reading = capacity::read_held_out(device, &decoder, held_out, &messages[TRAINING_MESSAGES..])?;
        capacity::check_reading(&reading, bits as usize, clip.path())?;
        let report = KeyReport {
            key_id: prf.key_id().to_string(),
            bits: bits as usize,
            spectrum,
            held_out_accuracy: reading.bit_accuracy,
            held_out_exact: reading.exact,
            seconds: started.elapsed().as_secs_f64(),
        };
        Ok((Self { secret, table, decoder, text_mean, codes, clip: digest_of(clip) }, report))
    }

    /// The key's pseudo-random function.
    #[must_use]
    pub fn prf(&self) -> Prf {
        Prf::new(&self.secret)
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

    /// The message that this key alone decides, the same in every model: what `random` stands for.
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

    /// Writes the key file, whole or not at all.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] or [`EngineError::Io`] naming the file.
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), EngineError> {
        let mut file = TensorFile { path: path.to_owned(), ..TensorFile::default() };
        let bits = self.bits();
        file.meta.insert("format".to_owned(), FORMAT.to_owned());
        file.meta.insert("bits".to_owned(), bits.to_string());
        file.meta.insert("clip".to_owned(), self.clip.to_string());
        file.meta.insert("secret".to_owned(), hex::encode(self.secret.expose()));
        let ids = self.table.ids().as_flattened().to_vec();
        file.tensors.insert("token_table".to_owned(), Tensor::u32(&[bits, 2], ids));
        file.tensors.insert("text_mean".to_owned(), Tensor::f32(&[self.text_mean.len()], self.text_mean.clone()));
        file.tensors.insert("codes".to_owned(), Tensor::f32(&[bits, self.text_mean.len()], self.codes.clone()));
        self.decoder.store(&mut file);
        let content = Digest::of(&file.to_bytes()?);
        file.meta.insert(CONTENT.to_owned(), content.to_string());
        AtomicFile::write(path, existing, &file.to_bytes()?)
    }

    /// Reads a key file made for `clip`, and checks that its table follows from its secret and that nothing was
    /// changed.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming what does not fit.
    pub fn read(path: &Path, clip: &ClipModel) -> Result<Self, EngineError> {
        let file = TensorFile::read(path)?;
        file.expect_text("format", FORMAT)?;
        let bits_text = file.text("bits")?;
        let bits: u32 = bits_text.parse().map_err(|_| file.bad("bits", bits_text, "a number"))?;
        let mut secret = [0; 32];
        hex::decode_to_slice(file.text("secret")?, &mut secret)
            .map_err(|e| file.bad("secret", &e.to_string(), "64 hex digits"))?;
        let clip_text = file.text("clip")?;
        let clip_digest =
            Digest::from_hex(clip_text).ok_or_else(|| file.bad("clip", clip_text, "a hash of 64 digits"))?;
        // Another checkpoint's sizes would make the checks below speak of something else.
        check_clip(path, clip_digest, clip)?;
        let secret = MasterSecret::from_bytes(secret);
        let width = clip.config().projection_dim;
        let key = Self {
            table: TokenTable::derive(&Prf::new(&secret), vocabulary(clip), bits)?,
            text_mean: file.finite("text_mean", &[width])?.to_vec(),
            codes: file.finite("codes", &[bits as usize, width])?.to_vec(),
            decoder: DecoderWeights::load(&file, width, bits as usize)?,
            clip: clip_digest,
            secret,
        };
        if file.integers("token_table", &[bits as usize, 2])? != key.table.ids().as_flattened() {
            return Err(file.bad("token_table", "a table that does not follow from the secret", "the derived table"));
        }
        check_content(file)?;
        Ok(key)
    }
}

/// A checkpoint's hash as receipts and keys write it.
#[must_use]
pub fn digest_of(clip: &ClipModel) -> Digest {
    Digest::from_bytes(*clip.hash().as_bytes())
}

/// Refuses another checkpoint than the one that a key was made with.
fn check_clip(path: &Path, made_with: Digest, clip: &ClipModel) -> Result<(), EngineError> {
    if made_with == digest_of(clip) {
        return Ok(());
    }
    Err(EngineError::BadData {
        path: path.to_owned(),
        field: "clip".to_owned(),
        got: format!("a key made with checkpoint {made_with}"),
        expected: format!("one made with checkpoint {} ({})", digest_of(clip), clip.path().display()),
    })
}

/// Refuses a file of which anything was changed: what was trained does not follow from the secret at a glance.
fn check_content(mut file: TensorFile) -> Result<(), EngineError> {
    let stated = file.text(CONTENT)?.to_owned();
    file.meta.remove(CONTENT);
    let found = Digest::of(&file.to_bytes()?).to_string();
    if found == stated {
        return Ok(());
    }
    Err(file.bad(CONTENT, &found, &format!("{stated}: the key was changed after it was made")))
}

#[allow(clippy::cast_possible_truncation, reason = "token ids are 32-bit")]
fn vocabulary(clip: &ClipModel) -> Vocabulary {
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

/// Where the master secret of a new key comes from.
///
/// # Errors
/// [`EngineError::MissingInput`] or [`EngineError::Io`] naming the file; [`EngineError::BadData`] unless it holds 64
/// hex digits.
pub fn read_secret(path: Option<&PathBuf>) -> Result<MasterSecret, EngineError> {
    let Some(path) = path else { return MasterSecret::generate() };
    let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path: path.clone(), expected: "a file with a master secret".to_owned() }
        }
        _ => EngineError::Io { path: path.clone(), source },
    })?;
    let mut bytes = [0; 32];
    hex::decode_to_slice(text.trim(), &mut bytes).map_err(|e| EngineError::BadData {
        path: path.clone(),
        field: "secret".to_owned(),
        got: e.to_string(),
        expected: "64 hex digits".to_owned(),
    })?;
    Ok(MasterSecret::from_bytes(bytes))
}
