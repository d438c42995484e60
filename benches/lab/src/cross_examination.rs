//! Where the message lives: in the asset, or in the extractor.
//!
//! An extractor that was trained with a message can print it whatever it is shown. What it says where the message
//! is not, and whether another copy makes it say something else, tells the two cases apart.

use guard4d_engine::base::prf::Purpose;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::claim::Claim;
use guard4d_engine::evidence::control::{ChanceDeviation, Control, ControlKind};
use guard4d_engine::evidence::judgement::{Evidence, judge};
use guard4d_engine::evidence::message::Message;
use guard4d_engine::evidence::other_keys::OtherKeys;
use guard4d_engine::evidence::per_bit::PerBit;
use guard4d_engine::evidence::reading::Reading;
use guard4d_engine::evidence::thresholds::Thresholds;
use guard4d_engine::media::Frame;
use guard4d_engine::release::evaluate::{HeldOut, chance_deviation, read_clips};
use guard4d_engine::watermark::embed::Subject;
use guard4d_engine::watermark::extractor::reader::{ClipFeatures, Reader};
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::Key;
use serde::Serialize;

/// An unmarked scene that has nothing to do with the asset.
#[derive(Clone, Copy, Debug)]
pub struct OtherScene<'a> {
    /// For the report.
    pub name: &'a str,
    /// Clips of clean 8-bit frames.
    pub clips: &'a [Vec<Frame>],
}

/// What a finished extractor is confronted with.
#[derive(Clone, Copy, Debug)]
pub struct Witnesses<'a> {
    /// Unmarked scenes.
    pub scenes: &'a [OtherScene<'a>],
    /// A key of as many bits that had no part in the embedding.
    pub other_key: &'a Key,
    /// The extractor before it was trained, if it was; see [`guard4d_engine::watermark::embed::Embedding::fitted`].
    pub untrained: Option<&'a ExtractorWeights>,
}

/// What the extractor said.
#[derive(Clone, Debug, Serialize)]
pub struct CrossExamination {
    /// All marked frames as one suspect clip, with every other reading as a control.
    pub evidence: Evidence,
    /// Bits of the message in other scenes' clips; none without other scenes.
    pub other_scenes: Option<ChanceDeviation>,
    /// The same bit by bit, over the clips of all other scenes.
    pub other_scenes_bits: Option<PerBit>,
    /// Bits of the message in the marked clips, read by the same extractor with the other key's key: what the private
    /// extractor file gives away by itself, since its calibration assigns directions to bits.
    pub wrong_key: ChanceDeviation,
    /// Bits of the other key's own message there: at chance.
    pub wrong_key_own: ChanceDeviation,
    /// Bits of the message in the marked clips, read by the untrained extractor: what the asset alone carries.
    pub untrained: Option<ChanceDeviation>,
}

/// Confronts an extractor with the marked clips and with what carries no mark.
///
/// # Errors
/// [`EngineError::Usage`] when keys, checkpoint and message lengths do not fit; when the device fails.
pub fn cross_examine(
    subject: &Subject<'_>,
    extractor: &ExtractorWeights,
    held_out: &HeldOut,
    witnesses: &Witnesses<'_>,
) -> Result<CrossExamination, EngineError> {
    let (message, bits) = (subject.message, subject.key.bits());
    let read = |key: &Key, extractor: &ExtractorWeights, clips: &[Vec<Frame>]| {
        read_clips(&mut Reader::new(subject.device, subject.clip, key, extractor)?, clips, bits)
    };
    let mut controls = Vec::new();
    for (i, reading) in read(subject.key, extractor, &held_out.clean)?.into_iter().enumerate() {
        let name = format!("clean view {i}");
        controls.push(Control { kind: ControlKind::CleanRender, name, reading, message: *message });
    }
    let mut elsewhere = Vec::new();
    for scene in witnesses.scenes {
        for (i, reading) in read(subject.key, extractor, scene.clips)?.into_iter().enumerate() {
            let name = format!("{} {i}", scene.name);
            elsewhere.push(reading.clone());
            controls.push(Control { kind: ControlKind::UnrelatedClip, name, reading, message: *message });
        }
    }
    let other_key = witnesses.other_key;
    let strange = read(other_key, extractor, &held_out.marked)?;
    let own = other_key.own_message();
    for (i, reading) in strange.iter().cloned().enumerate() {
        let name = format!("view {i}");
        controls.push(Control { kind: ControlKind::OtherKey, name, reading, message: own });
    }
    let untrained =
        witnesses.untrained.map(|e| chance_deviation(&read(subject.key, e, &held_out.marked)?, message)).transpose()?;
    let elsewhere = Some(elsewhere).filter(|readings| !readings.is_empty());
    Ok(CrossExamination {
        evidence: evidence(subject, extractor, held_out, &controls)?,
        other_scenes: elsewhere.as_ref().map(|readings| chance_deviation(readings, message)).transpose()?,
        other_scenes_bits: elsewhere.as_ref().map(|readings| PerBit::of(readings, message)).transpose()?,
        wrong_key: chance_deviation(&strange, message)?,
        wrong_key_own: chance_deviation(&strange, &own)?,
        untrained,
    })
}

/// Judges all marked frames as one clip.
fn evidence(
    subject: &Subject<'_>,
    extractor: &ExtractorWeights,
    held_out: &HeldOut,
    controls: &[Control],
) -> Result<Evidence, EngineError> {
    let mut reader = Reader::new(subject.device, subject.clip, subject.key, extractor)?;
    let mut clip_features = ClipFeatures::default();
    for clip in &held_out.marked {
        clip_features.extend(&reader.look(clip)?);
    }
    let prf = subject.key.prf();
    let sides = held_out.marked.iter().flatten().map(|frame| frame.width().min(frame.height()));
    let claim = Claim {
        message: *subject.message,
        searched: extractor.key_rotation.of,
        mode: extractor.mode,
        reading: &Reading::from_logits(&clip_features.logits, subject.message.num_bits())?,
        other_keys: &OtherKeys::derive(&prf, &extractor.calibration.coordinates(&clip_features.features))?,
        side_px: sides.min().unwrap_or(0),
        controls,
        objections: &[],
    };
    judge(&claim, &Thresholds::for_bits(subject.key.bits()))
}

/// The message of the second copy in a swap: it shares half of its bits with the first one's.
///
/// Whoever recites the first message then reads the second at chance, and whoever reads the second reads the first
/// at chance.
#[must_use]
pub fn swap_message(message: &Message, key: &Key) -> Message {
    message.half_flipped(&mut key.prf().stream(Purpose::SwapMessage, u64::from(message.num_bits())))
}

/// What the extractor of one copy reads from a second copy with another message.
#[derive(Clone, Debug, Serialize)]
pub struct Swap {
    /// Bits of the second copy's message: high if copies carry their messages, at chance if the extractor does.
    pub second: ChanceDeviation,
    /// Bits of the first copy's message: at chance if copies carry their messages, high if the extractor does.
    pub first: ChanceDeviation,
}

/// Reads a second copy of the subject's asset, which carries `second`, through the extractor of the first.
///
/// # Errors
/// As [`cross_examine`].
pub fn read_swap(
    subject: &Subject<'_>,
    extractor: &ExtractorWeights,
    copy: &HeldOut,
    second: &Message,
) -> Result<Swap, EngineError> {
    let mut reader = Reader::new(subject.device, subject.clip, subject.key, extractor)?;
    let readings = read_clips(&mut reader, &copy.marked, subject.key.bits())?;
    Ok(Swap { second: chance_deviation(&readings, second)?, first: chance_deviation(&readings, subject.message)? })
}

/// Clips of the subject's asset that somebody else marked: with another key, another message and another extractor.
#[derive(Clone, Copy, Debug)]
pub struct OtherOwner<'a> {
    /// For the report.
    pub name: &'a str,
    /// Clips of marked 8-bit frames, of the asset that the subject marked too.
    pub clips: &'a [Vec<Frame>],
}

/// What an extractor says of copies that other owners marked.
#[derive(Clone, Debug, Serialize)]
pub struct OtherOwners {
    /// Bits of the subject's message, which is in none of them, in all clips together: at chance if it takes the
    /// subject's mark to make the extractor say it, and not just any mark.
    pub all: ChanceDeviation,
    /// The same bit by bit.
    pub bits: PerBit,
    /// The same owner by owner, with their names.
    pub owners: Vec<(String, ChanceDeviation)>,
}

/// Reads copies that other owners marked through the subject's key and extractor; `None` without a clip.
///
/// # Errors
/// As [`cross_examine`].
pub fn read_other_owners(
    subject: &Subject<'_>,
    extractor: &ExtractorWeights,
    owners: &[OtherOwner<'_>],
) -> Result<Option<OtherOwners>, EngineError> {
    let mut reader = Reader::new(subject.device, subject.clip, subject.key, extractor)?;
    let (mut all, mut each) = (Vec::new(), Vec::new());
    for owner in owners.iter().filter(|owner| !owner.clips.is_empty()) {
        let readings = read_clips(&mut reader, owner.clips, subject.key.bits())?;
        each.push((owner.name.to_owned(), chance_deviation(&readings, subject.message)?));
        all.extend(readings);
    }
    if all.is_empty() {
        return Ok(None);
    }
    let (chance_deviation, bits) = (chance_deviation(&all, subject.message)?, PerBit::of(&all, subject.message)?);
    Ok(Some(OtherOwners { all: chance_deviation, bits, owners: each }))
}
