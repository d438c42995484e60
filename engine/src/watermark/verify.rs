//! Reading a mark from video, with the evidence for and against it.

use std::path::{Path, PathBuf};

use guard4d_kernels::Device;

use super::delivery::EXTRACTOR;
use super::digest::Digest;
use super::edits::{Edit, EditSearch};
use super::evidence::{Claim, DecisionStatistic, Evidence, ExtractorMode, Thresholds, judge};
use super::extractor::{ExtractorWeights, PREPROCESS, Reader, Sight, decode};
use super::general::GeneralExtractor;
use super::id_code::{IdBits, IdCode, IdReading, SearchedP};
use super::key::Key;
use super::message::{Message, Payload};
use super::mixing::Mixing;
use super::null_panel::{Control, ControlKind};
use super::other_keys::ThrowawayKeys;
use super::reading::Reading;
use super::receipt::Receipt;
use crate::clip::Clip;
use crate::error::EngineError;
use crate::media::framing::{Framing, Rect};
use crate::media::source::Ending;
use crate::media::{Frame, FrameSource, Integrity, ReadOptions};
use crate::render::Film;
use crate::scene::{CameraSet, Model};

/// What is verified against what.
#[derive(Debug)]
pub struct Case<'a> {
    /// Device.
    pub device: &'a Device,
    /// Frozen CLIP.
    pub clip: &'a Clip,
    /// Owner key.
    pub key: &'a Key,
    /// What the clips are asked for; by default what the receipt says: whichever id fits best if it is for an id, else
    /// the key's own message.
    pub sought: Option<Sought>,
    /// Receipt of the embedding; the extractor lies beside it.
    pub receipt: &'a Path,
    /// What an extractor that calls itself general has to look along; the built-in one unless it is given.
    pub general: Option<&'a GeneralExtractor>,
}

/// What clips are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sought {
    /// This message.
    Message(Message),
    /// This id; what id fits best is told beside it.
    Id {
        /// Its code.
        code: IdCode,
        /// Id claimed.
        id: u32,
    },
    /// Whichever id fits best. It may be another than the receipt's, for one key can mark many copies.
    AnyId(IdCode),
}

impl Sought {
    /// Reads what [`Payload::parse`] reads, or `id:12` or `id:16` alone for whichever id fits best, for `key`.
    ///
    /// # Errors
    /// Those of [`Payload::parse`].
    pub fn parse(text: &str, key: &Key) -> Result<Self, EngineError> {
        let bits = num_bits(key);
        if let Some(id_bits) = IdBits::parse(text) {
            return Ok(Self::AnyId(IdCode::new(id_bits, bits)?));
        }
        Ok(match Payload::parse(text, bits)? {
            Payload::Id { code, id } => Self::Id { code, id },
            payload => Self::Message(payload.message(&key.prf())?),
        })
    }
}

/// Clips to read and clips to compare with.
#[derive(Debug, Default)]
pub struct Exhibits {
    /// Suspect clips: folders of pictures, or videos.
    pub suspects: Vec<PathBuf>,
    /// What may have been done to all of them alike, and is undone where that brings them nearer to the claim.
    pub edits: EditSearch,
    /// Clips that surely carry no mark.
    pub unrelated: Vec<PathBuf>,
    /// Frames of the unmarked asset, one list per clip.
    pub clean: Vec<Vec<Frame>>,
    /// Keys that had no part in the embedding.
    pub strangers: Vec<Stranger>,
}

/// Somebody else's key.
#[derive(Debug)]
pub struct Stranger {
    /// For the report.
    pub name: String,
    /// As long as the owner's, and made with the same checkpoint.
    pub key: Key,
}

/// What the suspect clips say about ids.
#[derive(Clone, Copy, Debug, serde::Serialize)]
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

/// What was undone before the suspect clips were read.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct UndoneEdit {
    /// The edit without which the clips are nearest to the claim.
    #[serde(flatten)]
    pub edit: Edit,
    /// How many were tried, nothing at all among them; every p-value is multiplied by it.
    pub tried: u32,
}

/// How one suspect clip reads by itself.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ClipReading {
    /// File or folder.
    pub name: String,
    /// Bits that match the message.
    pub matches: u32,
    /// Share of them.
    pub bit_accuracy: f64,
    /// Whether the message was recovered without any wrong bit.
    pub exact: bool,
    /// The best id, if ids are asked for.
    pub id: Option<u32>,
    /// The part of its frames that was read, if not all.
    pub cut: Option<Rect>,
}

/// How far the reading of one clip is.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// File or folder.
    pub path: &'a Path,
    /// Frames read.
    pub frames: u64,
    /// Frames that there seem to be, where the clip says so.
    pub expected: Option<u64>,
}

/// Is told of every frame that is read; an error ends the reading.
pub type Watcher<'a> = &'a mut dyn FnMut(Progress<'_>) -> Result<(), EngineError>;

/// The evidence, with what went into it.
#[derive(Debug, serde::Serialize)]
pub struct Report {
    /// Verdict, p-value, null panel.
    pub evidence: Evidence,
    /// What the evidence rests on: the receipt's commitment. That it is older than the clip, this report cannot say.
    pub commitment: Digest,
    /// Mixing that the extractor reads through.
    pub mixing: Mixing,
    /// What was undone, if edits were asked for.
    pub edit: Option<UndoneEdit>,
    /// The id read, if ids are asked for.
    pub id: Option<IdEvidence>,
    /// Each suspect clip by itself.
    pub clips: Vec<ClipReading>,
    /// Frames read.
    pub frames: usize,
    /// What the decoder of a damaged video said.
    pub damage: Vec<String>,
}

/// What the receipt commits to, as far as the question knows it.
struct Promised {
    message: Message,
    /// Its code and number, if it is an id.
    id: Option<(IdCode, u32)>,
    /// Whether any other id will do, too.
    any_id: bool,
}

/// What was read of the suspect clips.
struct Suspects {
    /// Of all clips together, without each edit that may have been done.
    sights: Vec<Sight>,
    side_px: u32,
    frames: usize,
    damage: Vec<String>,
    clips: Vec<ClipSeen>,
}

/// What was read of one of them.
struct ClipSeen {
    name: String,
    /// Without each edit.
    readings: Vec<Reading>,
    cut: Option<Rect>,
}

/// What the suspect clips say without one of the edits.
struct Answer {
    /// Its number.
    edit: usize,
    reading: Reading,
    /// What they are compared with.
    message: Message,
    /// The best id, and what it proves as the best of all.
    id: Option<(IdReading, SearchedP)>,
    /// As if nothing had been chosen; the least decides between edits.
    p: SearchedP,
    /// Sum of the logits signed by the message, over the norm of the logits.
    clearness: f64,
}

impl Case<'_> {
    /// Reads all clips and weighs them. All suspect clips count as one: their frames share their bias.
    ///
    /// Frames are read as they are decoded, so that films of any length take the same memory but for their features. The
    /// framing of `options` is for suspect clips alone, as that is where a picture can have been framed anew.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when receipt, key, message, extractor or a clip do not fit; when the device fails.
    pub fn verify(&self, exhibits: &Exhibits, options: &ReadOptions) -> Result<Report, EngineError> {
        self.verify_watched(exhibits, options, &mut |_| Ok(()))
    }

    /// [`Self::verify`], which tells `watch` of every frame.
    ///
    /// # Errors
    /// Those of [`Self::verify`] and of `watch`.
    pub fn verify_watched(
        &self,
        exhibits: &Exhibits,
        options: &ReadOptions,
        watch: Watcher<'_>,
    ) -> Result<Report, EngineError> {
        let receipt = Receipt::read(self.receipt)?;
        receipt.verify_commitment(self.receipt)?;
        self.check_key(&receipt)?;
        self.check_rule(&receipt)?;
        let promised = self.promised(&receipt)?;
        let extractor = self.extractor(&receipt)?;
        let prf = self.key.prf();
        let mut reader = Reader::new(self.device, self.clip, self.key, &extractor)?;
        let edits = exhibits.edits.guesses();
        let suspects = self.look(&mut reader, (&exhibits.suspects, &edits), options, watch)?;
        let rule = &receipt.body.promise.thresholds;
        let Answer { edit, reading, message, id, .. } = self.nearest(&suspects, &promised, rule.statistic)?;
        let tried = u32::try_from(edits.len()).unwrap_or(u32::MAX);
        let chosen = extractor.mixing.of.saturating_mul(tried);
        let mut searched = chosen;
        let id = promised.id.zip(id).map(|((code, number), (found, p))| {
            if promised.any_id {
                searched = searched.saturating_mul(p.searched);
            }
            let is_blind = extractor.mode.is_message_blind();
            id_evidence(code, number, found, is_blind.then(|| p.among(chosen)))
        });
        let mut controls = self.controls(&mut reader, exhibits, options, watch, message)?;
        let sight = &suspects.sights[edit];
        for stranger in &exhibits.strangers {
            controls.push(self.stranger(stranger, &extractor, sight)?);
        }
        let coordinates = extractor.calibration.coordinates(&sight.features);
        let claim = Claim {
            message,
            searched,
            mode: extractor.mode,
            reading: &reading,
            throwaway: &ThrowawayKeys::derive(&prf, &coordinates)?,
            side_px: suspects.side_px,
            controls: &controls,
        };
        let evidence = judge(&claim, rule)?;
        let code = promised.id.map(|(code, _)| code);
        let clips = suspects.clips.iter().map(|clip| self.alone(clip, edit, &message, code));
        let clips = clips.collect::<Result<_, _>>()?;
        let Suspects { frames, damage, .. } = suspects;
        let edit = (tried > 1).then(|| UndoneEdit { edit: edits[edit], tried });
        Ok(Report {
            evidence,
            commitment: receipt.commitment,
            mixing: extractor.mixing,
            edit,
            id,
            clips,
            frames,
            damage,
        })
    }

    /// What the suspects say without the edit that brings them nearest to what is sought.
    fn nearest(
        &self,
        suspects: &Suspects,
        promised: &Promised,
        statistic: DecisionStatistic,
    ) -> Result<Answer, EngineError> {
        let answers = (0..).zip(&suspects.sights).map(|(edit, sight)| self.answer(edit, sight, promised));
        let answers = answers.collect::<Result<Vec<_>, _>>()?;
        let p = |answer: &Answer| match statistic {
            DecisionStatistic::Matches => answer.p.matches,
            DecisionStatistic::SoftScore => answer.p.soft_score,
        };
        // Where several leave no bit wrong: rather nothing than an edit, and of edits the one of the clearest bits.
        let nearest = answers.into_iter().min_by(|a, b| {
            let is_edited = |answer: &Answer| answer.edit > 0;
            let equals = || is_edited(a).cmp(&is_edited(b)).then(b.clearness.total_cmp(&a.clearness));
            p(a).total_cmp(&p(b)).then_with(equals)
        });
        Ok(nearest.expect("nothing at all is always among the edits"))
    }

    fn answer(&self, edit: usize, sight: &Sight, promised: &Promised) -> Result<Answer, EngineError> {
        let reading = Reading::from_logits(&sight.logits, num_bits(self.key))?;
        let (mut message, mut id) = (promised.message, None);
        if let Some((code, _)) = promised.id {
            let prf = self.key.prf();
            let (found, p) = code.read(&reading, &prf)?;
            if promised.any_id {
                message = code.message(found.id, &code.pad(&prf)?)?;
            }
            id = Some((found, p));
        }
        let p = SearchedP::of(&reading, &message, 1)?;
        let margins = reading.margins(&message)?;
        let clearness = margins.iter().sum::<f64>() / margins.iter().map(|m| m * m).sum::<f64>().sqrt();
        Ok(Answer { edit, reading, message, id, p, clearness })
    }

    fn look(
        &self,
        reader: &mut Reader,
        (paths, edits): (&[PathBuf], &[Edit]),
        options: &ReadOptions,
        watch: Watcher<'_>,
    ) -> Result<Suspects, EngineError> {
        let mut all = Suspects {
            sights: vec![Sight::default(); edits.len()],
            side_px: u32::MAX,
            frames: 0,
            damage: Vec::new(),
            clips: Vec::new(),
        };
        for path in paths {
            let source = FrameSource::open(path, options)?;
            let (sights, ending) = look_at(reader, path, (&source, edits), watch)?;
            if let Integrity::Damaged { messages } = ending.integrity {
                all.damage.push(format!("{}: {messages}", path.display()));
            }
            let (width, height) = ending.size_px;
            all.side_px = all.side_px.min(width).min(height);
            all.frames += sights[0].logits.len() / self.key.bits();
            let readings = sights.iter().map(|sight| Reading::from_logits(&sight.logits, num_bits(self.key)));
            let readings = readings.collect::<Result<_, _>>()?;
            all.clips.push(ClipSeen { name: path.display().to_string(), readings, cut: source.cut() });
            for (whole, sight) in all.sights.iter_mut().zip(&sights) {
                whole.extend(sight);
            }
        }
        Ok(all)
    }

    /// One suspect clip by itself, without the edit of that number.
    fn alone(
        &self,
        clip: &ClipSeen,
        edit: usize,
        message: &Message,
        code: Option<IdCode>,
    ) -> Result<ClipReading, EngineError> {
        let reading = &clip.readings[edit];
        let matches = reading.matches(message)?;
        let read = |code: IdCode| code.decode(reading.mean_logits(), &code.pad(&self.key.prf())?);
        Ok(ClipReading {
            name: clip.name.clone(),
            matches,
            bit_accuracy: f64::from(matches) / f64::from(message.num_bits()),
            exact: matches == message.num_bits(),
            id: code.map(read).transpose()?.map(|found| found.id),
            cut: clip.cut,
        })
    }

    /// Clips that carry no mark, to be compared with `message`.
    fn controls(
        &self,
        reader: &mut Reader,
        exhibits: &Exhibits,
        options: &ReadOptions,
        watch: Watcher<'_>,
        message: Message,
    ) -> Result<Vec<Control>, EngineError> {
        let mut controls = Vec::new();
        let mut weigh = |kind, name, logits: &[f32]| {
            let reading = Reading::from_logits(logits, message.num_bits())?;
            controls.push(Control { kind, name, reading, message });
            Ok::<_, EngineError>(())
        };
        let options = ReadOptions { framing: Framing::default(), ..options.clone() };
        for path in &exhibits.unrelated {
            let source = FrameSource::open(path, &options)?;
            let (sights, _) = look_at(reader, path, (&source, &[Edit::NONE]), watch)?;
            weigh(ControlKind::UnrelatedClip, path.display().to_string(), &sights[0].logits)?;
        }
        for (i, clean) in exhibits.clean.iter().enumerate() {
            weigh(ControlKind::CleanRender, format!("clean view {i}"), &reader.logits(clean)?)?;
        }
        Ok(controls)
    }

    /// The suspect clips read with another trained key, for the message that key would embed.
    fn stranger(
        &self,
        stranger: &Stranger,
        extractor: &ExtractorWeights,
        sight: &Sight,
    ) -> Result<Control, EngineError> {
        let Stranger { name, key } = stranger;
        let bits = num_bits(self.key);
        let usage = |got: &str, expected: String| {
            Err(EngineError::Usage { what: format!("other key {name}"), got: got.to_owned(), expected })
        };
        if key.bits() != self.key.bits() {
            return usage(&format!("{} bits", key.bits()), format!("{bits} bits like the owner's"));
        }
        if key.prf().key_id() == self.key.prf().key_id() {
            return usage("the owner's key", "a key that had no part in the embedding".to_owned());
        }
        let logits = decode(self.device, key, &extractor.calibration, &sight.features)?;
        Ok(Control {
            kind: ControlKind::OtherKey,
            name: name.clone(),
            reading: Reading::from_logits(&logits, bits)?,
            message: key.own_message(),
        })
    }

    /// Refuses a receipt of another key.
    fn check_key(&self, receipt: &Receipt) -> Result<(), EngineError> {
        let promise = &receipt.body.promise;
        let prf = self.key.prf();
        if promise.key_id != prf.key_id() {
            let (got, expected) = (promise.key_id.to_string(), prf.key_id().to_string());
            return Err(bad(self.receipt, "key_id", got, format!("{expected}, the key given")));
        }
        let committed = [
            ("token_table", promise.token_table, self.key.table.digest()),
            ("decoder", promise.decoder, self.key.decoder_digest()),
            ("clip", promise.clip, self.key.clip),
        ];
        for (field, promised, given) in committed {
            if promised != given {
                return Err(bad(self.receipt, field, promised.to_string(), format!("{given}, as in the key given")));
            }
        }
        Ok(())
    }

    /// Refuses a receipt that asks for less than this program does, or for frames that are seen otherwise. Whoever seals a
    /// receipt could write any rule into it.
    fn check_rule(&self, receipt: &Receipt) -> Result<(), EngineError> {
        let promise = &receipt.body.promise;
        let rule = Thresholds::for_bits(self.key.bits());
        if !promise.thresholds.is_as_strict_as(&rule) {
            let expected = format!("a rule at least as strict as {rule:?}");
            return Err(bad(self.receipt, "thresholds", format!("{:?}", promise.thresholds), expected));
        }
        if promise.preprocess != PREPROCESS {
            return Err(bad(self.receipt, "preprocess", promise.preprocess.clone(), PREPROCESS.to_owned()));
        }
        Ok(())
    }

    /// The message that the receipt commits to, which has to be what is sought, or one of the ids that are.
    fn promised(&self, receipt: &Receipt) -> Result<Promised, EngineError> {
        let prf = self.key.prf();
        let sought = match (self.sought, receipt.body.promise.payload) {
            (Some(sought), _) => sought,
            (None, Some(id_bits)) => Sought::AnyId(IdCode::new(id_bits, num_bits(self.key))?),
            (None, None) => Sought::Message(self.key.own_message()),
        };
        let found = match sought {
            Sought::Message(message) => Some(Promised { message, id: None, any_id: false }),
            Sought::Id { code, id } => {
                let message = code.message(id, &code.pad(&prf)?)?;
                Some(Promised { message, id: Some((code, id)), any_id: false })
            }
            Sought::AnyId(code) => {
                let pad = code.pad(&prf)?;
                let messages = (0..code.id_bits().num_ids()).filter_map(|id| Some((id, code.message(id, &pad).ok()?)));
                let mut committed = messages.filter(|(_, message)| receipt.commits_to(message, &prf));
                committed.next().map(|(id, message)| Promised { message, id: Some((code, id)), any_id: true })
            }
        };
        found.filter(|promised| receipt.commits_to(&promised.message, &prf)).ok_or_else(|| {
            let got = "a commitment to another message".to_owned();
            bad(self.receipt, "message_mac", got, "one to the message given with --message".to_owned())
        })
    }

    /// The extractor beside the receipt, after checking that receipt and extractor belong together.
    fn extractor(&self, receipt: &Receipt) -> Result<ExtractorWeights, EngineError> {
        let path = self.receipt.with_file_name(EXTRACTOR);
        let extractor = ExtractorWeights::read(&path, self.key)?;
        let digest = extractor.digest(self.key)?;
        let mode = receipt.body.promise.extractor_mode;
        if extractor.mode != mode {
            let expected = format!("{mode}, as committed in the receipt");
            return Err(bad(&path, "mode", extractor.mode.to_string(), expected));
        }
        let promised = receipt.body.promise.extractor;
        if promised != Some(digest) {
            let expected = promised.map_or_else(|| "none".to_owned(), |d| d.to_string());
            return Err(bad(&path, "hash", digest.to_string(), format!("{expected}, as committed in the receipt")));
        }
        if mode == ExtractorMode::General {
            self.check_general(&path, &extractor)?;
        }
        Ok(extractor)
    }

    /// Refuses an extractor that calls itself general and looks elsewhere: its directions could have been chosen for a clip.
    fn check_general(&self, path: &Path, extractor: &ExtractorWeights) -> Result<(), EngineError> {
        let built_in;
        let known = match self.general {
            Some(given) => given,
            None => {
                built_in = GeneralExtractor::built_in()?;
                &built_in
            }
        };
        known.check_key(self.key)?;
        if !extractor.calibration.is_along(known, &mut extractor.mixing.stream(&self.key.prf())) {
            let number = extractor.mixing.number;
            let expected = format!("those of the general extractor {}, by the key's mixing {number}", known.digest()?);
            return Err(bad(path, "calibration.directions", "others".to_owned(), expected));
        }
        Ok(())
    }
}

/// Reads one clip from its first frame to its last without each edit, and never holds more of it than [`Reader`] looks at together.
fn look_at(
    reader: &mut Reader,
    path: &Path,
    (source, edits): (&FrameSource, &[Edit]),
    watch: Watcher<'_>,
) -> Result<(Vec<Sight>, Ending), EngineError> {
    let expected = source.expected_frames();
    let mut watching = reader.watch(edits);
    let mut frames = 0;
    let ending = source.for_each(&mut |frame| {
        watching.push(frame)?;
        frames += 1;
        watch(Progress { path, frames, expected })
    })?;
    Ok((watching.finish()?, ending))
}

fn id_evidence(code: IdCode, promised: u32, found: IdReading, p_value: Option<SearchedP>) -> IdEvidence {
    IdEvidence {
        id_bits: code.id_bits(),
        distance: code.distance(),
        found,
        margin: found.margin(),
        promised,
        is_promised: found.id == promised,
        p_value,
    }
}

fn num_bits(key: &Key) -> u32 {
    u32::try_from(key.bits()).unwrap_or(u32::MAX)
}

fn bad(path: &Path, field: &str, got: String, expected: String) -> EngineError {
    EngineError::BadData { path: path.to_owned(), field: field.to_owned(), got, expected }
}

/// 8-bit frames of an unmarked model, one list per clip.
///
/// # Errors
/// When the device fails.
pub fn clean_clips(device: &Device, model: &Model, cameras: &CameraSet) -> Result<Vec<Vec<Frame>>, EngineError> {
    let shots = cameras.clips();
    let mut clips = vec![Vec::new(); shots.len()];
    let mut film = Film::new(device, &model.gaussians, &model.motion, model.background)?;
    film.shoot(&shots, |number, camera, pixels| {
        clips[number].push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
        Ok(())
    })?;
    Ok(clips)
}
