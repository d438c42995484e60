//! `guard4d.receipt/3`: what was embedded where, a commitment that no later change survives, and the owner's signature.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::evaluate::ClassFigure;
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::base::prf::{KeyId, Prf};
use crate::base::signature::{PublicKey, Signature, SigningKey};
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::evidence::id_code::IdBits;
use crate::evidence::message::Message;
use crate::evidence::thresholds::Thresholds;
use crate::picture::metrics::PsnrSummary;
use crate::scene::camera::classes::CameraClass;
use crate::watermark::embed::EmbedConfig;
use crate::watermark::key::owner_key::Key;

/// Domain of the commitment hash of receipts that bind their reader, and of those from before.
const COMMITMENT_CONTEXTS: [&str; 2] =
    ["guard4d receipt commitment, version 2", "guard4d receipt commitment, version 1"];
/// What stands before the commitment in what is signed.
const SIGNATURE_CONTEXT: &[u8] = b"guard4d receipt signature, version 1";

/// Receipts this program reads. The commitment covers by its domain whether a receipt binds its reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Schema {
    /// First version, whose settings are spelled otherwise.
    #[serde(rename = "guard4d.receipt/1")]
    V1,
    /// Settings as `embed --config` takes them.
    #[serde(rename = "guard4d.receipt/2")]
    V2,
    /// Bound to all that reads a film and to one asset, and signed.
    #[serde(rename = "guard4d.receipt/3")]
    V3,
}

impl Schema {
    /// Whether all that reads a film is fixed by the receipt: of older ones a part of the key file is free.
    #[must_use]
    pub fn covers_reader(self) -> bool {
        self == Self::V3
    }
}

/// The name that files use.
impl std::fmt::Display for Schema {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.serialize(f)
    }
}

/// The program that wrote a receipt.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tool {
    /// Package version.
    pub version: String,
    /// Revision of the sources, if the build knew it (`GUARD4D_GIT_REVISION` at compile time).
    pub git_revision: Option<String>,
}

impl Tool {
    /// This build.
    #[must_use]
    pub fn current() -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            git_revision: option_env!("GUARD4D_GIT_REVISION").map(str::to_owned),
        }
    }
}

/// What is fixed before release: revealing it in a dispute leaves no freedom to fit anything.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Promise {
    /// Public name of the owner's key.
    pub key_id: KeyId,
    /// Number of message bits.
    pub num_bits: u32,
    /// Keyed MAC of the message; see [`Message::commitment`].
    pub message_mac: Digest,
    /// Kind of id that the message carries; none for other messages, as in receipts from before there were ids.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub payload: Option<IdBits>,
    /// Hash of the token table.
    pub token_table: Digest,
    /// Hash of the decoder's weights.
    pub decoder: Digest,
    /// How the extractor came about.
    pub extractor_mode: ExtractorMode,
    /// Hash of the extractor's weights; none for the identity.
    pub extractor: Option<Digest>,
    /// Hash of the CLIP checkpoint.
    pub clip: Digest,
    /// Version of resize, normalisation and 8-bit rounding before CLIP.
    pub preprocess: String,
    /// Decision rule.
    pub thresholds: Thresholds,
    /// The owner's chips; none where none were written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub owner_chips: Option<OwnerChips>,
    /// What ties the rest together; none in receipts from before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<Anchor>,
}

/// Chips by which the owner proves the asset from any camera: what they are follows from the key of the asset and the
/// asset's hash, both of which the receipt fixes too.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnerChips {
    /// What the amplitudes of all octaves are multiplied by.
    pub strength: f64,
}

/// What ties key, extractor and asset of a receipt together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Anchor {
    /// Hash of the unmarked asset, from which the key of the asset follows.
    pub asset: Digest,
    /// Hash of all that a picture of the unmarked asset depends on: splats, motion and background. What is fitted to
    /// the asset follows from these.
    pub scene: Digest,
    /// Hash over everything that turns frames into logits; see [`crate::watermark::extractor::reader::digest`].
    pub reader: Digest,
    /// Whose signature the receipt has.
    pub signer: PublicKey,
}

impl Promise {
    /// The key that reads what this promise is about, from the owner's or from a disclosed one.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a key that has none for this asset.
    pub fn key_for(&self, key: &Key) -> Result<Key, EngineError> {
        self.anchor.map_or_else(|| Ok(key.clone()), |anchor| key.for_asset(anchor.asset))
    }
}

/// A file and its hash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileRecord {
    /// Path relative to the model or output folder, with forward slashes.
    pub path: String,
    /// BLAKE3 of the bytes.
    pub blake3: Digest,
}

impl FileRecord {
    /// Hashes `folder/path`.
    ///
    /// # Errors
    /// Those of [`Digest::of_file`].
    pub fn of(folder: &Path, path: &str) -> Result<Self, EngineError> {
        Ok(Self { path: path.to_owned(), blake3: Digest::of_file(&folder.join(path))? })
    }
}

/// Share of bits read correctly, from decoded 8-bit frames of held-out views and times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BitAccuracies {
    /// Mean over single frames.
    pub frame: f64,
    /// Mean over clips, logits averaged first.
    pub clip: f64,
    /// Clips of the unmarked asset.
    pub clean: Option<f64>,
    /// Clips of the unmarked asset with noise.
    pub noisy: Option<f64>,
}

/// Measured quality of the result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figures {
    /// Marked against unmarked render.
    pub psnr: PsnrSummary,
    /// The same within the foreground; none if nothing is in view.
    pub foreground_psnr: Option<PsnrSummary>,
    /// Structural similarity, mean over views.
    pub ssim: f64,
    /// Perceptual distance, if it was computed.
    pub lpips: Option<f64>,
    /// Bits read correctly.
    pub bit_accuracy: BitAccuracies,
    /// Bits read correctly in films of each class of cameras; none in receipts from before these were measured.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub classes: BTreeMap<CameraClass, ClassFigure>,
}

/// Whether running again on the same device gives the same bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Repeatability {
    /// The same bytes.
    SameBytes,
    /// The same decision only.
    SameDecision,
}

/// Device the work ran on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceRecord {
    /// Device name as the driver gives it.
    pub name: String,
    /// Driver name and version.
    pub driver: String,
    /// Kernel family; none in receipts from before there were two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kernels: Option<String>,
    /// Vulkan version.
    pub api_version: String,
    /// What a second run gives.
    pub repeatability: Repeatability,
}

/// Everything a receipt holds beside its commitment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReceiptBody {
    /// Program that wrote it.
    pub tool: Tool,
    /// What is fixed before release.
    pub promise: Promise,
    /// Files of the unmarked asset.
    pub inputs: Vec<FileRecord>,
    /// Files of the marked asset.
    pub outputs: Vec<FileRecord>,
    /// Settings of the run, seed included.
    pub settings: Value,
    /// Measured quality.
    pub figures: Figures,
    /// Wall-clock seconds per stage.
    pub seconds: BTreeMap<String, f64>,
    /// Most device memory taken from the driver at one time, in bytes; none in receipts from before it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_memory_bytes: Option<u64>,
    /// Device used.
    pub device: DeviceRecord,
}

/// A receipt: body and commitment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Receipt {
    /// Format.
    pub schema: Schema,
    /// Content.
    pub body: ReceiptBody,
    /// BLAKE3 over the canonical form of `body`.
    pub commitment: Digest,
    /// The owner's signature of the commitment; none in receipts from before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signature: Option<Signature>,
}

impl Receipt {
    /// Seals a body with its commitment, and signs it.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] if a figure is NaN or infinite (an infinite PSNR is allowed).
    pub fn seal(body: ReceiptBody, signer: &SigningKey) -> Result<Self, EngineError> {
        let commitment = commit(&body, Schema::V3)?;
        Ok(Self { schema: Schema::V3, body, commitment, signature: Some(signer.sign(&signed(&commitment))) })
    }

    /// The settings of the embedding.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming `path` (where the receipt was read) if there are none.
    pub fn config(&self, path: &Path) -> Result<EmbedConfig, EngineError> {
        let settings = self.body.settings.get("config").cloned().unwrap_or_default();
        serde_json::from_value(settings)
            .map_err(|error| bad_data(path, "settings.config", error, "the settings of an embedding"))
    }

    /// Checks that the body is the one that was sealed, and by whom it says it was.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming `path` (where the receipt was read) if it was changed.
    pub fn verify_commitment(&self, path: &Path) -> Result<(), EngineError> {
        let computed = commit(&self.body, self.schema)?;
        if computed != self.commitment {
            let expected = format!("{computed}: the receipt was changed after it was sealed");
            return Err(bad_data(path, "commitment", self.commitment, expected));
        }
        match (self.schema.covers_reader(), &self.body.promise.anchor, &self.signature) {
            (false, None, None) => Ok(()),
            (true, Some(anchor), Some(signature)) => {
                if anchor.signer.has_signed(&signed(&self.commitment), signature) {
                    return Ok(());
                }
                Err(bad_data(path, "signature", "one of something else", format!("one by {}", anchor.signer)))
            }
            (false, ..) => Err(bad_data(path, "schema", self.schema, "a later one: this has an anchor or a signature")),
            (true, None, _) => Err(bad_data(path, "anchor", "none", "the hashes of asset and reader, and a signer")),
            (true, _, None) => Err(bad_data(path, "signature", "none", "that of the signer that the receipt names")),
        }
    }

    /// Whether the receipt commits to this message under this key.
    #[must_use]
    pub fn commits_to(&self, message: &Message, prf: &Prf) -> bool {
        let promise = &self.body.promise;
        promise.key_id == prf.key_id()
            && promise.num_bits == message.num_bits()
            && promise.message_mac == message.commitment(prf)
    }

    /// Reads a receipt and checks its commitment.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], or [`EngineError::BadData`] for anything that is
    /// not an unchanged receipt of a known version.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        let receipt = Self::parse(path, &fs::read(path).map_err(|source| read_error(path, source))?)?;
        receipt.verify_commitment(path)?;
        Ok(receipt)
    }

    /// Parses `json`, which came from `path`; whether it is unchanged, [`Receipt::verify_commitment`] says.
    ///
    /// # Errors
    /// [`EngineError::BadData`] saying at which line and column.
    pub fn parse(path: &Path, json: &[u8]) -> Result<Self, EngineError> {
        crate::base::json::parse(path, "receipt", json, "a guard4d.receipt")
    }

    /// Writes the receipt as indented JSON; never over an existing file.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if the file exists or cannot be created, [`EngineError::Io`] if writing
    /// fails.
    pub fn write(&self, path: &Path) -> Result<(), EngineError> {
        let mut json = serde_json::to_vec_pretty(self).map_err(|error| not_json(&error))?;
        json.push(b'\n');
        let mut file = fs::File::create_new(path)
            .map_err(|error| EngineError::CannotCreate { path: path.to_path_buf(), reason: error.to_string() })?;
        let io = |source| EngineError::Io { path: path.to_path_buf(), source };
        file.write_all(&json).map_err(io)?;
        file.sync_all().map_err(io)
    }
}

fn read_error(path: &Path, source: std::io::Error) -> EngineError {
    let path = path.to_path_buf();
    match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path, expected: "a receipt written by `guard4d embed`".to_owned() }
        }
        std::io::ErrorKind::InvalidData => EngineError::BadData {
            path,
            field: "text".to_owned(),
            got: "bytes that are not UTF-8".to_owned(),
            expected: "JSON".to_owned(),
        },
        _ => EngineError::Io { path, source },
    }
}

fn not_json(error: &serde_json::Error) -> EngineError {
    EngineError::NotFinite { what: format!("receipt: {error}"), got: f64::NAN }
}

/// Hash of the body's canonical form: every field in name order, each value with a type tag and its
/// length, numbers by their bits. Layout, order and spelling of the JSON do not matter; values do.
fn commit(body: &ReceiptBody, schema: Schema) -> Result<Digest, EngineError> {
    check_finite(body)?;
    let value = serde_json::to_value(body).map_err(|error| not_json(&error))?;
    let mut hasher = blake3::Hasher::new_derive_key(COMMITMENT_CONTEXTS[usize::from(!schema.covers_reader())]);
    absorb(&mut hasher, &value);
    Ok(Digest::from_bytes(*hasher.finalize().as_bytes()))
}

/// What is signed for a commitment.
fn signed(commitment: &Digest) -> Vec<u8> {
    [SIGNATURE_CONTEXT, commitment.as_bytes()].concat()
}

/// JSON writes NaN and infinity as `null`, where they would look like "not measured".
fn check_finite(body: &ReceiptBody) -> Result<(), EngineError> {
    let Figures { ssim, lpips, bit_accuracy: bits, ref classes, .. } = body.figures;
    let rule = body.promise.thresholds;
    let figures = [
        ("ssim", Some(ssim)),
        ("lpips", lpips),
        ("frame bit accuracy", Some(bits.frame)),
        ("clip bit accuracy", Some(bits.clip)),
        ("clean bit accuracy", bits.clean),
        ("noisy bit accuracy", bits.noisy),
        ("threshold fpr", Some(rule.fpr)),
        ("threshold absent_above", Some(rule.absent_above)),
        ("threshold control_level", Some(rule.control_level)),
    ];
    let chips = body.promise.owner_chips.map(|chips| ("strength of the owner's chips", Some(chips.strength)));
    let in_class = classes.values().flat_map(|class| [class.bit_accuracy, class.proven]);
    let in_class = in_class.map(|share| ("films of a class", Some(share)));
    let seconds = body.seconds.iter().map(|(stage, &s)| (stage.as_str(), Some(s)));
    for (what, value) in figures.into_iter().chain(chips).chain(in_class).chain(seconds) {
        if let Some(got) = value.filter(|v| !v.is_finite()) {
            let what = format!("receipt figure `{what}`");
            return Err(EngineError::NotFinite { what, got });
        }
    }
    Ok(())
}

fn absorb(hasher: &mut blake3::Hasher, value: &Value) {
    let mut tagged = |tag: u8, bytes: &[u8]| {
        hasher.update(&[tag]);
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    match value {
        Value::Null => tagged(b'0', &[]),
        Value::Bool(b) => tagged(b'b', &[u8::from(*b)]),
        Value::String(text) => tagged(b's', text.as_bytes()),
        Value::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
            (Some(n), _, _) => tagged(b'u', &n.to_le_bytes()),
            (_, Some(n), _) => tagged(b'i', &n.to_le_bytes()),
            (_, _, Some(x)) => tagged(b'f', &x.to_bits().to_le_bytes()),
            (None, None, None) => tagged(b'n', number.to_string().as_bytes()),
        },
        Value::Array(items) => {
            tagged(b'[', &(items.len() as u64).to_le_bytes());
            items.iter().for_each(|item| absorb(hasher, item));
        }
        Value::Object(fields) => {
            tagged(b'{', &(fields.len() as u64).to_le_bytes());
            let sorted: BTreeMap<_, _> = fields.iter().collect();
            for (name, item) in sorted {
                absorb(hasher, &Value::String(name.clone()));
                absorb(hasher, item);
            }
        }
    }
}
