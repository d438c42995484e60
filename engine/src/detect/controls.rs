//! Controls beside a question: clips that carry no mark, and keys that had no part in it.

use std::collections::HashSet;
use std::path::PathBuf;

use guard4d_kernels::Device;

use super::clip_reader::ClipReader;
use crate::base::digest::Digest;
use crate::error::EngineError;
use crate::evidence::control::{Control, ControlKind};
use crate::evidence::message::Message;
use crate::evidence::reading::Reading;
use crate::media::Frame;
use crate::watermark::extractor::reader::decode;
use crate::watermark::extractor::weights::ExtractorWeights;
use crate::watermark::key::owner_key::Key;

/// A trained key of somebody else.
#[derive(Debug)]
pub struct OtherKey {
    /// For the report.
    pub name: String,
    /// As long as the owner's, and made with the same checkpoint.
    pub key: Key,
}

/// Clips that carry no mark.
pub(super) struct Unmarked<'a> {
    /// Videos and folders.
    pub(super) unrelated: &'a [PathBuf],
    /// Renders of the unmarked asset.
    pub(super) clean: &'a [Vec<Frame>],
    /// Those of [`super::own_clips`].
    pub(super) own: &'a [Vec<Frame>],
}

impl Unmarked<'_> {
    /// Reads all of them, to be compared with `message`. A film that is given again is no further control, however it
    /// is packed: one that shows the reader the same, frame by frame, counts once.
    ///
    /// # Errors
    /// Those of reading a clip.
    pub(super) fn read(&self, reader: &mut ClipReader<'_>, message: Message) -> Result<Vec<Control>, EngineError> {
        let mut controls = Vec::new();
        let mut add = |kind, name, logits: &[f32]| {
            let reading = Reading::from_logits(logits, message.num_bits())?;
            controls.push(Control { kind, name, reading, message });
            Ok::<_, EngineError>(())
        };
        let mut seen = HashSet::new();
        for path in self.unrelated {
            let clip = reader.plain_video(path)?;
            if seen.insert(Digest::of(bytemuck::cast_slice(&clip.features))) {
                add(ControlKind::UnrelatedClip, path.display().to_string(), &clip.logits)?;
            }
        }
        for (i, frames) in self.clean.iter().enumerate() {
            add(ControlKind::CleanRender, format!("clean view {i}"), &reader.logits(frames)?)?;
        }
        for (i, frames) in self.own.iter().enumerate() {
            add(ControlKind::OwnClip, format!("procedural scene {i}"), &reader.logits(frames)?)?;
        }
        Ok(controls)
    }
}

impl OtherKey {
    /// `features` of the suspect clips `[n, D]`, read with this key by the owner's extractor, for the message that this
    /// key would embed.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a key of another length and for the owner's own; when the device fails.
    pub(super) fn read(
        &self,
        device: &Device,
        owner: &Key,
        extractor: &ExtractorWeights,
        features: &[f32],
    ) -> Result<Control, EngineError> {
        let Self { name, key } = self;
        let key = &match owner.asset() {
            Some(asset) => key.for_asset(asset)?,
            None => key.clone(),
        };
        let usage = |got: String, expected: String| {
            Err(EngineError::Usage { what: format!("other key {name}"), got, expected })
        };
        let num_bits = owner.num_bits();
        if key.num_bits() != num_bits {
            return usage(format!("{} bits", key.num_bits()), format!("{num_bits} bits like the owner's"));
        }
        if key.public_key() == owner.public_key() {
            let expected = "a key that had no part in the embedding";
            return usage("the owner's key".to_owned(), expected.to_owned());
        }
        let logits = decode(device, key, &extractor.calibration, features)?;
        Ok(Control {
            kind: ControlKind::OtherKey,
            name: name.clone(),
            reading: Reading::from_logits(&logits, num_bits)?,
            message: key.own_message(),
        })
    }
}
