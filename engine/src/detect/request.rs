//! What is asked of suspect clips, and what they are compared with.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use guard4d_kernels::Device;

use super::controls::OtherKey;
use super::sought::Sought;
use super::suspect::{FilmedSuspect, Suspect};
use super::verify_cache::VerifyCache;
use crate::base::digest::Digest;
use crate::media::Frame;
use crate::networks::clip::ClipModel;
use crate::picture::undo_guess::GuessSearch;
use crate::release::dating::standing::DateFiles;
use crate::release::delivery::EXTRACTOR;
use crate::scene::{Camera, Model};
use crate::watermark::extractor::pretrained::PretrainedExtractor;
use crate::watermark::key::owner_key::Key;

/// What is verified, by whom.
#[derive(Clone, Copy, Debug)]
pub struct VerifyRequest<'a> {
    /// Device.
    pub device: &'a Device,
    /// Frozen CLIP.
    pub clip: &'a ClipModel,
    /// Key of the asset that the receipt is about, see [`crate::release::receipt::Promise::key_for`].
    pub key: &'a Key,
    /// What the clips are asked for; by default what the receipt says: whichever id fits best if it is for an id, else
    /// the key's own message.
    pub sought: Option<Sought>,
    /// Receipt of the embedding; the extractor lies beside it.
    pub receipt: &'a Path,
    /// What an extractor that calls itself pretrained has to look along; the built-in one unless it is given.
    pub pretrained: Option<&'a PretrainedExtractor>,
    /// The unmarked asset: the extractor is fitted to it again.
    pub original: Option<&'a Model>,
    /// A CLIP checkpoint that whoever verifies knows to be published by somebody else, beside the program's own.
    pub trusted_clip: Option<Digest>,
    /// Claims that this one was chosen from: receipts, keys, owners and films that were or could have been tried.
    pub claims: NonZeroU32,
    /// What the verifications before it have made, if there were any.
    pub cache: &'a VerifyCache,
}

impl VerifyRequest<'_> {
    /// Where the extractor lies: beside the receipt.
    #[must_use]
    pub fn extractor_path(&self) -> PathBuf {
        self.receipt.with_file_name(EXTRACTOR)
    }
}

/// Clips to read and clips to compare with.
#[derive(Debug, Default)]
pub struct VerifyInputs {
    /// What is under suspicion.
    pub suspects: Vec<Suspect>,
    /// Films among them whose cameras are known frame by frame: the owner's chips are read in these.
    pub filmed: Vec<FilmedSuspect>,
    /// Films among them whose cameras are looked for, to read the chips in them, where none are known and the message
    /// alone does not prove it.
    pub locatable: Vec<PathBuf>,
    /// Cameras near which these films were taken, inside of the scene; none where they were taken from all around.
    pub near: Vec<Camera>,
    /// What may have been done to all of it alike, and is undone where that brings it nearer to the claim.
    pub guesses: GuessSearch,
    /// Videos that surely carry no mark; one that is given twice is read once.
    pub unrelated: Vec<PathBuf>,
    /// Frames of the unmarked asset, one list per clip.
    pub clean: Vec<Vec<Frame>>,
    /// Keys that had no part in the embedding.
    pub other_keys: Vec<OtherKey>,
    /// What dates the receipt.
    pub dates: DateFiles,
}
