//! The part of an extractor that follows from the asset: free for whoever seals a receipt, unless somebody who has the
//! original fits it again.

use serde::Serialize;

use super::request::VerifyRequest;
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::release::receipt::Receipt;
use crate::scene::Model;
use crate::watermark::embed::Subject;
use crate::watermark::extractor::weights::{Deviation, ExtractorWeights};

/// Furthest that an extractor may be from the one that is fitted again, as a share of its size. On one device both are
/// the same to the bit. From one kernel family to the other the directions move by 1.2e-3, and nothing else by more
/// (demo, `blind` and `pretrained`, draft); a rotation, another asset or chosen zeros move them by about 1.
const TOLERANCE: f64 = 2e-2;

/// How much of an extractor was free when its receipt was sealed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FreePart {
    /// Numbers that were fitted to the asset.
    pub numbers: usize,
    /// Whether they are what the original gives.
    pub checked: Checked,
}

/// Whether the free part was looked at.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "how", rename_all = "snake_case")]
pub enum Checked {
    /// The original was not there, or the receipt names none. Who sealed the receipt could have chosen any numbers.
    NotChecked,
    /// Fitted again to the original, with the receipt's settings, and found to be the same but for arithmetic.
    Refitted {
        /// How far apart they are.
        deviation: Deviation,
    },
    /// Trained with the message: no p-value is given that it could spoil.
    Trained,
}

impl FreePart {
    /// Fits the extractor again if the original is there.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for another original than the receipt's, and for an extractor that does not follow from
    /// it; those of fitting.
    pub(super) fn check(
        request: &VerifyRequest<'_>,
        receipt: &Receipt,
        extractor: &ExtractorWeights,
    ) -> Result<Self, EngineError> {
        let knows_directions = extractor.mode == ExtractorMode::Pretrained && request.pretrained.is_none();
        let numbers = extractor.free_numbers(knows_directions);
        let checked = match (extractor.mode, request.original, &receipt.body.promise.anchor) {
            (ExtractorMode::Joint, ..) => Checked::Trained,
            (_, Some(original), Some(anchor)) => {
                let hashes = [("asset", anchor.asset, original.digest()), ("scene", anchor.scene, original.content())];
                for (field, promised, given) in hashes {
                    if promised != given {
                        let expected = format!("{given}, the hash of the original given");
                        return Err(bad_data(request.receipt, field, promised, expected));
                    }
                }
                Checked::Refitted { deviation: compare(request, receipt, extractor, original)? }
            }
            _ => Checked::NotChecked,
        };
        Ok(Self { numbers, checked })
    }
}

fn compare(
    request: &VerifyRequest<'_>,
    receipt: &Receipt,
    extractor: &ExtractorWeights,
    original: &Model,
) -> Result<Deviation, EngineError> {
    let VerifyRequest { device, clip, key, cache, .. } = *request;
    let mut config = receipt.config(request.receipt)?;
    if config.mode() != extractor.mode {
        let expected = format!("{}, the mode of the extractor", extractor.mode);
        return Err(bad_data(request.receipt, "settings.config.extractor", config.mode(), expected));
    }
    config.open_weights()?;
    // The message has no part in fitting; any will do.
    let message = key.own_message();
    let subject = Subject { device, clip, key, model: original, message: &message };
    let fitted = cache.refit(subject, &config, extractor.key_rotation)?;
    let deviation = extractor.deviation(&fitted);
    let Deviation { colour_map, mean_image, directions, mean_logits, known_views, content } = deviation;
    let parts = [
        ("tmsd.colour_map", colour_map),
        ("calibration.mean_image", mean_image),
        ("calibration.directions", directions),
        ("calibration.mean_logits", mean_logits),
        ("known_views", known_views),
        ("content", content),
    ];
    // A NaN is further than any bound.
    match parts.into_iter().find(|(_, apart)| apart.is_nan() || *apart > TOLERANCE) {
        None => Ok(deviation),
        Some((part, apart)) => {
            let got = format!("values {apart:.1e} of their size away from what the original gives");
            let expected = format!("at most {TOLERANCE:e}: the extractor does not follow from the asset");
            Err(bad_data(&request.extractor_path(), part, got, expected))
        }
    }
}
