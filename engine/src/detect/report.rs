//! What a verification says.

use std::num::NonZeroU32;

use serde::Serialize;

use super::compared_message::ComparedMessage;
use super::exhibit::Exhibit;
use super::free_part::FreePart;
use super::owner_chips::ChipsReading;
use super::request::{VerifyInputs, VerifyRequest};
use super::suspect::{Suspect, SuspectClip};
use crate::base::digest::Digest;
use crate::base::prf::Prf;
use crate::error::EngineError;
use crate::evidence::id_code::{IdBits, IdCode, IdReading, SearchedP};
use crate::evidence::judgement::{Evidence, Verdict};
use crate::evidence::message::Message;
use crate::evidence::reading::Reading;
use crate::locate::finding::LocateReport;
use crate::media::ReadOptions;
use crate::media::framing::{Crop, Rect};
use crate::picture::part::Framings;
use crate::picture::undo_guess::UndoGuess;
use crate::release::dating::standing::Standing;
use crate::release::receipt::{Promise, Schema};
use crate::watermark::extractor::rotation::KeyRotation;

/// The evidence, with what went into it.
#[derive(Debug, Serialize)]
pub struct VerifyReport {
    /// The answer, of all that was read.
    pub verdict: Verdict,
    /// What was read of the message: its own verdict, p-value, negative controls.
    pub evidence: Evidence,
    /// What the message says beside the original, where that could be compared.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compared_message: Option<ComparedMessage>,
    /// What the owner's chips say, where they were read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub owner_chips: Option<ChipsReading>,
    /// How the cameras of films were found, where they were looked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub located: Vec<LocateReport>,
    /// What the evidence rests on: the receipt's commitment. That it is older than the clip, this report cannot say.
    pub commitment: Digest,
    /// Version of the receipt.
    pub schema: Schema,
    /// How much of the extractor was free when the receipt was sealed, and whether that was checked.
    pub free_part: FreePart,
    /// What whoever verifies was free to choose.
    pub choices: Choices,
    /// Its date, if it has one, and the root that it is under.
    #[serde(flatten)]
    pub standing: Standing,
    /// Rotation that the extractor reads through.
    pub key_rotation: KeyRotation,
    /// What was undone, if there was anything to guess.
    pub undone: Option<Undone>,
    /// The id read, if ids are asked for.
    pub id: Option<IdEvidence>,
    /// Each suspect clip by itself.
    pub clips: Vec<ClipReading>,
    /// Frames read.
    pub frames: usize,
    /// What the decoder of a damaged video said.
    pub damage: Vec<String>,
    /// Bit by bit what was claimed and what was read.
    pub bits: Vec<BitReading>,
    /// What the receipt has fixed; there to be read, so that JSON does not repeat it.
    #[serde(skip)]
    pub promise: Promise,
    /// Some of the frames read.
    #[serde(skip)]
    pub exhibits: Vec<Exhibit>,
}

/// One bit of the message, in all suspect clips together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BitReading {
    /// What the message says.
    pub claimed: bool,
    /// Mean logit of all frames: above 0 the bit reads as 1.
    pub logit: f64,
}

impl BitReading {
    /// Whether it reads as claimed.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.claimed == (self.logit > 0.0)
    }

    /// All bits of a message.
    pub(super) fn all(message: &Message, reading: &Reading) -> Vec<Self> {
        message.bits().zip(reading.mean_logits()).map(|(claimed, &logit)| Self { claimed, logit }).collect()
    }
}

/// What whoever verifies was free to choose. Each choice that was tried until the film read best is a claim of its own:
/// `claims` counts them, and multiplies every p-value.
#[derive(Clone, Debug, Serialize)]
pub struct Choices {
    /// Receipts, keys, owners, films and readings that this one was chosen from, as whoever verifies says.
    pub claims: u32,
    /// Suspect films and models that are read as one.
    pub films: usize,
    /// Those among them that are models, filmed by cameras that whoever verifies chose.
    pub models: usize,
    /// Those among them that are films cut as cameras say that whoever verifies gave.
    pub known_cameras: usize,
    /// Whether whoever verifies vouches for a CLIP checkpoint that is not the program's own.
    pub vouches_for_clip: bool,
    /// Whether whoever verifies gave the directions of a pretrained extractor.
    pub gives_directions: bool,
    /// First frame read.
    pub start: u32,
    /// One of so many frames is read.
    pub every: u32,
    /// Most frames read of each film.
    pub max_frames: Option<u32>,
    /// Part of the frames that was named by hand.
    pub crop: Option<Rect>,
    /// Size that pictures were brought to by hand.
    pub picture_size_px: Option<(u32, u32)>,
}

impl Choices {
    pub(super) fn of(request: &VerifyRequest<'_>, inputs: &VerifyInputs, options: &ReadOptions) -> Self {
        let crop = match options.framing.crop {
            Crop::Region(rect) => Some(rect),
            Crop::Whole | Crop::Auto => None,
        };
        Self {
            claims: request.claims.get(),
            films: inputs.suspects.len(),
            models: inputs.suspects.iter().filter(|suspect| matches!(suspect, Suspect::Model { .. })).count(),
            known_cameras: inputs.suspects.iter().filter(|suspect| matches!(suspect, Suspect::Filmed { .. })).count(),
            vouches_for_clip: request.trusted_clip.is_some(),
            gives_directions: request.pretrained.is_some(),
            start: options.start,
            every: options.every.get(),
            max_frames: options.max_frames.map(NonZeroU32::get),
            crop,
            picture_size_px: options.framing.size_px,
        }
    }
}

/// What was undone before the suspect clips were read.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Undone {
    /// The guess with which undone the clips are nearest to the claim.
    #[serde(flatten)]
    pub guess: UndoGuess,
    /// How many were tried, nothing at all among them; every p-value is multiplied by it.
    pub tried: u32,
}

/// What the suspect clips say about ids.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct IdEvidence {
    /// Length of the ids.
    pub id_bits: IdBits,
    /// Fewest bits in which the messages of two ids differ.
    pub distance: u32,
    /// The best id and the next one.
    #[serde(flatten)]
    pub found: IdReading,
    /// How far the best is ahead, in logits per bit.
    pub margin: f64,
    /// The id that the receipt commits to.
    pub promised: u32,
    /// Whether the best id is that one.
    pub is_promised: bool,
    /// Chance that the best of all ids agrees so well; none for a `joint` extractor, which has no p-value.
    pub p_value: Option<SearchedP>,
}

/// How one suspect clip reads by itself.
#[derive(Clone, Debug, Serialize)]
pub struct ClipReading {
    /// File, folder or view.
    pub name: String,
    /// Bits that match the message.
    pub matches: u32,
    /// Share of them.
    pub bit_accuracy: f64,
    /// Whether the message was recovered without any wrong bit.
    pub exact: bool,
    /// The best id, if ids are asked for.
    pub id: Option<u32>,
    /// Frames read.
    pub frames: u32,
    /// Width and height of its frames, without what is cut off.
    pub size_px: (u32, u32),
    /// The part of its frames that was read, if not all.
    pub cut: Option<Rect>,
    /// How frames were cut before CLIP saw them.
    pub framings: Framings,
    /// BLAKE3 of the file, or over those of a folder's files in hexadecimal; none of what was rendered.
    pub blake3: Option<Digest>,
}

impl ClipReading {
    /// One suspect clip by itself, with the guess of that number undone, compared with `message`; where ids of `code`
    /// are asked for, also its best id.
    ///
    /// # Errors
    /// [`EngineError::Usage`] when lengths differ.
    pub(super) fn of(
        clip: &SuspectClip,
        guess: usize,
        message: &Message,
        code: Option<IdCode>,
        prf: &Prf,
    ) -> Result<Self, EngineError> {
        let reading = clip.reading(guess);
        let matches = reading.matches(message)?;
        let read = |code: IdCode| code.decode(reading.mean_logits(), &code.pad(prf)?);
        Ok(Self {
            name: clip.name().to_owned(),
            matches,
            bit_accuracy: f64::from(matches) / f64::from(message.num_bits()),
            exact: matches == message.num_bits(),
            id: code.map(read).transpose()?.map(|found| found.id),
            frames: reading.num_frames(),
            size_px: clip.size_px(),
            cut: clip.cut(),
            framings: clip.framings().clone(),
            blake3: clip.content(),
        })
    }
}
