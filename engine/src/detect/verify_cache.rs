//! What verifications in one process have in common.

use std::sync::{Arc, Mutex};

use guard4d_kernels::Device;

use super::own_clips::own_clips;
use crate::base::digest::Digest;
use crate::base::held::Held;
use crate::base::prf::KeyId;
use crate::error::EngineError;
use crate::locate::film::Locator;
use crate::locate::views::Vantage;
use crate::media::Frame;
use crate::scene::Model;
use crate::watermark::embed::{EmbedConfig, Subject, refit};
use crate::watermark::extractor::rotation::KeyRotation;
use crate::watermark::extractor::weights::ExtractorWeights;

/// The program's own clips, the extractor that was fitted last, and the pictures that were drawn last of an original to
/// look for in films. All are what they would be if they were made again: on one device the same to the bit.
#[derive(Debug, Default)]
pub struct VerifyCache {
    own_clips: Held<(), Arc<Vec<Vec<Frame>>>>,
    fitted: Held<FittedTo, Arc<ExtractorWeights>>,
    locator: Held<Digest, Arc<Mutex<Locator>>>,
}

/// All that an extractor follows from.
#[derive(Debug, PartialEq)]
struct FittedTo {
    config: EmbedConfig,
    key_id: KeyId,
    clip: Digest,
    asset: Digest,
    scene: Digest,
    rotation: KeyRotation,
}

impl VerifyCache {
    /// Forgets all of it, as when the device was lost that made it.
    pub fn forget(&self) {
        self.own_clips.forget();
        self.fitted.forget();
        self.locator.forget();
    }

    /// [`own_clips`], filmed when they are first asked for.
    pub(super) fn own_clips(&self, device: &Device) -> Result<Arc<Vec<Vec<Frame>>>, EngineError> {
        self.own_clips.get((), || own_clips(device).map(Arc::new))
    }

    /// What looks for an original in films; one film at a time.
    ///
    /// # Errors
    /// Those of [`Locator::new`].
    pub fn locator(
        &self,
        device: &Device,
        original: &Model,
        vantage: Vantage<'_>,
    ) -> Result<Arc<Mutex<Locator>>, EngineError> {
        let new = || Locator::new(device, original, vantage).map(|locator| Arc::new(Mutex::new(locator)));
        self.locator.get(vantage.digest_of(original), new)
    }

    /// [`refit`], unless that is what was done last.
    pub(super) fn refit(
        &self,
        subject: Subject<'_>,
        config: &EmbedConfig,
        rotation: KeyRotation,
    ) -> Result<Arc<ExtractorWeights>, EngineError> {
        let Subject { key, model, .. } = subject;
        let fitted_to = FittedTo {
            config: config.clone(),
            key_id: key.prf().key_id(),
            clip: key.clip,
            asset: model.digest(),
            scene: model.content(),
            rotation,
        };
        self.fitted.get(fitted_to, || refit(subject, config, rotation).map(Arc::new))
    }
}
