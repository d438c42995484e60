//! The owner's side of a question: receipt and extractor, checked against the key and against each other.

use std::path::Path;

use super::request::VerifyRequest;
use super::sought::Promised;
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::evidence::reason::Reason;
use crate::evidence::thresholds::Thresholds;
use crate::release::receipt::{Anchor, Receipt};
use crate::watermark::extractor::pretrained::PretrainedExtractor;
use crate::watermark::extractor::reader;
use crate::watermark::extractor::weights::ExtractorWeights;
use crate::watermark::key::owner_key::Key;

/// What was fixed when the mark was written.
pub(super) struct Opened {
    receipt: Receipt,
    promised: Promised,
    extractor: ExtractorWeights,
    objections: Vec<Reason>,
}

impl Opened {
    /// Reads the receipt of a request and the extractor beside it.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when receipt, key, message and extractor do not belong together, when the receipt asks
    /// for less than this program does, and when the key does not follow from its secret; those of reading the files.
    pub(super) fn open(request: &VerifyRequest<'_>) -> Result<Self, EngineError> {
        let VerifyRequest { device, clip, key, receipt: path, sought, pretrained, .. } = *request;
        let receipt = Receipt::read(path)?;
        check_key(&receipt, path, key)?;
        check_rule(&receipt, path, key)?;
        let promised = Promised::find(sought, &receipt, path, key)?;
        let extractor = read_extractor(&receipt, &request.extractor_path(), key, pretrained)?;
        let (promise, given) = (&receipt.body.promise, extractor.preprocess());
        if promise.preprocess != given {
            return Err(bad_data(path, "preprocess", &promise.preprocess, given));
        }
        let mut objections = Vec::new();
        match &receipt.body.promise.anchor {
            Some(anchor) => {
                key.check(device, clip)?;
                check_anchor(anchor, path, key, &extractor)?;
            }
            None => objections.push(Reason::NotCommitted { schema: receipt.schema.to_string() }),
        }
        if !(clip.is_built_in() || request.trusted_clip == Some(key.clip)) {
            objections.push(Reason::UnknownClip { clip: key.clip.to_string() });
        }
        Ok(Self { receipt, promised, extractor, objections })
    }

    /// The receipt.
    pub(super) fn receipt(&self) -> &Receipt {
        &self.receipt
    }

    /// What is in the way of "present", whatever the clips say.
    pub(super) fn objections(&self) -> &[Reason] {
        &self.objections
    }

    /// What the receipt commits to.
    pub(super) fn promised(&self) -> &Promised {
        &self.promised
    }

    /// The extractor.
    pub(super) fn extractor(&self) -> &ExtractorWeights {
        &self.extractor
    }

    /// The rule of decision that the receipt has fixed.
    pub(super) fn rule(&self) -> &Thresholds {
        &self.receipt.body.promise.thresholds
    }

    /// The receipt's commitment.
    pub(super) fn commitment(&self) -> Digest {
        self.receipt.commitment
    }
}

/// Refuses a receipt of another key.
fn check_key(receipt: &Receipt, path: &Path, key: &Key) -> Result<(), EngineError> {
    let promise = &receipt.body.promise;
    let key_id = key.prf().key_id();
    if promise.key_id != key_id {
        return Err(bad_data(path, "key_id", promise.key_id, format!("{key_id}, the key given")));
    }
    let committed = [
        ("token_table", promise.token_table, key.table.digest()),
        ("decoder", promise.decoder, key.decoder_digest()),
        ("clip", promise.clip, key.clip),
    ];
    for (field, promised, given) in committed {
        if promised != given {
            return Err(bad_data(path, field, promised, format!("{given}, as in the key given")));
        }
    }
    Ok(())
}

/// Refuses a receipt of another reader, asset or signer than those at hand.
fn check_anchor(anchor: &Anchor, path: &Path, key: &Key, extractor: &ExtractorWeights) -> Result<(), EngineError> {
    // The scene is compared where the original is given.
    let Anchor { asset, scene: _, reader, signer } = anchor;
    if key.asset() != Some(*asset) {
        return Err(bad_data(path, "asset", asset, "the asset that the key is for"));
    }
    if *signer != key.public_key() {
        return Err(bad_data(path, "signer", signer, format!("{}, the owner of the key given", key.public_key())));
    }
    let given = reader::digest(key, extractor)?;
    if *reader != given {
        return Err(bad_data(path, "reader", reader, format!("{given}, as key and extractor give")));
    }
    Ok(())
}

/// Refuses a receipt that asks for less than this program does. Whoever seals a receipt could write any rule into it.
fn check_rule(receipt: &Receipt, path: &Path, key: &Key) -> Result<(), EngineError> {
    let promise = &receipt.body.promise;
    let rule = Thresholds::for_bits(key.bits());
    if !promise.thresholds.is_as_strict_as(&rule) {
        let expected = format!("a rule at least as strict as {rule:?}");
        return Err(bad_data(path, "thresholds", format!("{:?}", promise.thresholds), expected));
    }
    Ok(())
}

/// The extractor at `path`, after checking that receipt and extractor belong together.
fn read_extractor(
    receipt: &Receipt,
    path: &Path,
    key: &Key,
    pretrained: Option<&PretrainedExtractor>,
) -> Result<ExtractorWeights, EngineError> {
    let extractor = ExtractorWeights::read(path, key)?;
    let digest = extractor.digest(key)?;
    let mode = receipt.body.promise.extractor_mode;
    if extractor.mode != mode {
        return Err(bad_data(path, "mode", extractor.mode, format!("{mode}, as committed in the receipt")));
    }
    let promised = receipt.body.promise.extractor;
    if promised != Some(digest) {
        let expected = promised.map_or_else(|| "none".to_owned(), |d| d.to_string());
        return Err(bad_data(path, "hash", digest, format!("{expected}, as committed in the receipt")));
    }
    if mode == ExtractorMode::Pretrained {
        check_pretrained(&extractor, path, key, pretrained)?;
    }
    Ok(extractor)
}

/// Refuses an extractor that calls itself pretrained and looks elsewhere: its directions could have been chosen for a
/// clip.
fn check_pretrained(
    extractor: &ExtractorWeights,
    path: &Path,
    key: &Key,
    pretrained: Option<&PretrainedExtractor>,
) -> Result<(), EngineError> {
    let built_in;
    let known = match pretrained {
        Some(given) => given,
        None => {
            built_in = PretrainedExtractor::built_in()?;
            &built_in
        }
    };
    known.check_key(key)?;
    let rotation = extractor.key_rotation;
    if !extractor.calibration.is_along(known, &mut rotation.stream(&key.prf())) {
        let of = known.digest()?;
        let expected = format!("those of the pretrained extractor {of}, by the key's rotation {}", rotation.number);
        return Err(bad_data(path, "calibration.directions", "others", expected));
    }
    Ok(())
}
