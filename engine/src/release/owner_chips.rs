//! The owner's chips: what an embedding writes beside the mark, and proves the asset from any camera.

use guard4d_kernels::Device;

use super::receipt::OwnerChips;
use crate::error::EngineError;
use crate::fingerprint::fidelity::strength_onto;
use crate::fingerprint::issue::Issue;
use crate::scene::Model;
use crate::watermark::embed::EmbedConfig;
use crate::watermark::key::owner_key::Key;

/// Of chips that are alike in every copy any number will do.
const ALL_COPIES: u64 = 0;

/// Coefficients with chips, and what the receipt says of these.
#[derive(Clone, Debug, PartialEq)]
pub struct WithChips {
    /// Coefficients `[N, 16, 3]`.
    pub sh_coeffs: Vec<f32>,
    /// None where none are asked for, or none would be seen.
    pub chips: Option<OwnerChips>,
}

/// Adds the chips of the key of an asset to its marked coefficients, as strong as the settings leave room for.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn add(
    device: &Device,
    model: &Model,
    key: &Key,
    config: &EmbedConfig,
    marked: &[f32],
) -> Result<WithChips, EngineError> {
    let mut with_chips = WithChips { sh_coeffs: marked.to_vec(), chips: None };
    let Some(psnr_db) = config.fidelity.chips_psnr() else { return Ok(with_chips) };
    let strength = strength_onto(device, Issue::of_owner(model, key.prf(), 1.0), marked, psnr_db)?;
    if let Some(strength) = strength {
        let issue = Issue::of_owner(model, key.prf(), strength);
        with_chips.sh_coeffs = issue.stamp_onto(with_chips.sh_coeffs, ALL_COPIES);
        with_chips.chips = Some(OwnerChips { strength });
    }
    Ok(with_chips)
}
