//! What is claimed of a suspect, and what was read of it.

use super::control::Control;
use super::extractor_mode::ExtractorMode;
use super::message::Message;
use super::other_keys::OtherKeys;
use super::reading::Reading;
use super::reason::Reason;

/// What is claimed, and what was read.
#[derive(Clone, Debug)]
pub struct Claim<'a> {
    /// Message the owner committed to, or that was found in the reading.
    pub message: Message,
    /// Claims that it was chosen from, 1 if it was fixed beforehand: messages from which one was chosen after reading,
    /// times rotations from which the extractor's was chosen when the message was written, times receipts under the
    /// root by which this one is dated.
    pub searched: u32,
    /// Extractor that read the clip.
    pub mode: ExtractorMode,
    /// Its answer.
    pub reading: &'a Reading,
    /// Other keys, derived from the owner's, and what they read.
    pub other_keys: &'a OtherKeys,
    /// Shorter side of the suspect frames.
    pub side_px: u32,
    /// Readings that must be at chance.
    pub controls: &'a [Control],
    /// What is in the way of "present", whatever the clip says. With [`Reason::NotCommitted`] among them, the p-value
    /// is that of a test which could have been made to suit the clip.
    pub objections: &'a [Reason],
}
