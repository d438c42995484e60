//! Embeds and reads: what turns a cell into rows.

use std::collections::HashMap;
use std::path::PathBuf;
use std::rc::Rc;
use std::time::Instant;

use cpu_time::ProcessTime;
use guard4d_engine::base::output::Existing;
use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::control::ControlState;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::media::encode::{EncodeOptions, OddSize, write_video};
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::networks::lpips::Lpips;
use guard4d_engine::picture::distortion::DistortionChain;
use guard4d_engine::release::evaluate::{Evaluation, HeldOut};
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt};
use guard4d_engine::watermark::embed::{Embedded, Embedding, Estimate, Start, Subject};
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::{Key, digest_of};
use guard4d_kernels::{Device, KernelError};

use super::plan::{Arm, COPY_PX, Cell, Machine, Take};
use super::progress::{Step, Watcher};
use super::row::{Effort, Row, in_words};
use super::scene::{self, ORBIT_ELEVATION_DEG, Scene, SceneSource, Variant};
use crate::cross_examination::{
    CrossExamination, OtherOwner, OtherOwners, OtherScene, Swap, Witnesses, cross_examine, read_other_owners,
    read_swap, swap_message,
};
use crate::forgery::{ForgeConfig, forge};

/// Opens a device: each embedding has one of its own, so that its memory is its own.
pub type OpenDevice<'a> = &'a dyn Fn() -> Result<Device, EngineError>;

/// What measures.
pub(super) struct Lab<'a> {
    open: OpenDevice<'a>,
    clip: ClipSource<'a>,
    keys: PathBuf,
    sources: Vec<SceneSource>,
    machine: Machine,
    /// Scenes as they were filmed once, by all that decides it.
    filmed: HashMap<String, Rc<Scene>>,
}

/// An embedding with what it is read with.
struct Marked<'a> {
    subject: Subject<'a>,
    scene: &'a Scene,
    arm: &'a Arm,
    embedded: &'a Embedded,
}

impl<'a> Lab<'a> {
    /// Finds out what it runs on. Keys of seeds are kept in `keys`; they protect nothing, their secrets being the
    /// seeds.
    pub(super) fn open(
        open: OpenDevice<'a>,
        clip: ClipSource<'a>,
        keys: PathBuf,
        sources: &[SceneSource],
    ) -> Result<Self, EngineError> {
        let device = open()?;
        let info = device.info();
        let loaded = ClipModel::load(&device, &clip)?;
        let machine =
            Machine { device: format!("{}; {}", info.name, info.driver), clip: digest_of(&loaded).to_string() };
        Ok(Self { open, clip, keys, sources: sources.to_vec(), machine, filmed: HashMap::new() })
    }

    pub(super) fn machine(&self) -> &Machine {
        &self.machine
    }

    /// All readings of a cell. What cannot be embedded or read is a row that says why, not an error: where methods fail
    /// is a result.
    ///
    /// # Errors
    /// When the device is lost, when outputs cannot be written, and what `watch` says.
    pub(super) fn measure(&mut self, cell: &Cell, watch: Watcher<'_>) -> Result<Vec<Row>, EngineError> {
        let blank = Row::of(cell, &self.machine);
        match self.read_all(cell, &blank, watch) {
            Err(error) if is_a_result(&error) => {
                let failed = |take: &Take| Row { take: take.to_string(), error: error.to_string(), ..blank.clone() };
                Ok(cell.arm.takes.iter().map(failed).collect())
            }
            rows => rows,
        }
    }

    fn read_all(&mut self, cell: &Cell, blank: &Row, watch: Watcher<'_>) -> Result<Vec<Row>, EngineError> {
        let arm = &cell.arm;
        let device = (self.open)()?;
        if arm.is_tight {
            device.limit_memory(self.tight_budget(cell)?);
        }
        let clip = ClipModel::load(&device, &self.clip)?.in_precision(arm.precision);
        let seed = seed_of(arm);
        let key = self.key(&device, &clip, seed, arm.bits)?;
        // The next seed's key serves as the other key's, so that seeds in a row serve one another.
        let other_key = self.key(&device, &clip, seed.wrapping_add(1), arm.bits)?;
        let size = FrameSize::new(arm.config.views.size_px.0, arm.config.views.size_px.1)?;
        let scene = self.scene(&device, &cell.scene, arm.variant, size)?;
        let elsewhere = self.other_scenes(&device, &cell.scene, arm)?;
        let message = key.own_message();
        let subject = Subject { device: &device, clip: &clip, key: &key, model: &scene.model, message: &message };

        let (wall, cpu) = (Instant::now(), ProcessTime::now());
        let embedding = Embedding::prepare(subject, scene.framed(&arm.config))?;
        let fitted = embedding.fitted().clone();
        let embedded = train(embedding, watch)?;
        let (wall_s, cpu_s) = (wall.elapsed().as_secs_f64(), cpu.elapsed().as_secs_f64());
        let changed = embedded.sh_coeffs.iter().zip(&scene.model.gaussians.sh_coeffs).filter(|(m, c)| m != c);
        let effort = Effort {
            steps: embedded.steps,
            offsets: changed.count(),
            stages: ["plan", "fit", "train"].map(|stage| embedded.seconds.get(stage).copied().unwrap_or(0.0)),
            wall_s,
            cpu_s,
            peak_bytes: device.memory_use().peak_reserved_bytes,
        };
        let others: Vec<_> = elsewhere.iter().map(|(name, other)| OtherScene { name, clips: &other.clean }).collect();
        let untrained = (arm.config.mode() == ExtractorMode::Joint).then_some(&fitted);
        let witnesses = Witnesses { scenes: &others, other_key: &other_key, untrained };
        let marked = Marked { subject, scene: &scene, arm, embedded: &embedded };
        let mut rows = Vec::new();
        for take in &arm.takes {
            watch(Step::Reading(take))?;
            let (evaluation, examination) = marked.read(take, &witnesses)?;
            let row = blank.clone().took(&effort).read(take.to_string(), &evaluation).examined(&examination);
            let is_contested = arm.is_contested && *take == Take::Plain;
            rows.push(if is_contested { marked.contested(row, &fitted, &other_key, watch)? } else { row });
        }
        Ok(rows)
    }

    /// Room for all but half of the training clips.
    fn tight_budget(&mut self, cell: &Cell) -> Result<u64, EngineError> {
        let (arm, device) = (&cell.arm, (self.open)()?);
        let clip = ClipModel::load(&device, &self.clip)?.in_precision(arm.precision);
        let key = self.key(&device, &clip, seed_of(arm), arm.bits)?;
        let size = FrameSize::new(arm.config.views.size_px.0, arm.config.views.size_px.1)?;
        let scene = self.scene(&device, &cell.scene, arm.variant, size)?;
        let message = key.own_message();
        let subject = Subject { device: &device, clip: &clip, key: &key, model: &scene.model, message: &message };
        let estimate = Estimate::of(subject, &scene.framed(&arm.config))?;
        Ok(estimate.resident_bytes + (estimate.clips as u64).div_ceil(2) * estimate.clip_bytes)
    }

    /// The key of a seed, from the cache if it is there.
    fn key(&self, device: &Device, clip: &ClipModel, seed: u8, bits: u32) -> Result<Key, EngineError> {
        let digits: String = self.machine.clip.chars().take(12).collect();
        let path = self.keys.join(format!("{digits}-{bits}-{seed}.key"));
        if let Ok(key) = Key::read(&path, clip) {
            return Ok(key);
        }
        let secret = MasterSecret::from_bytes([seed.wrapping_add(1); 32]);
        let (key, _) = Key::generate(device, clip, secret, bits)?;
        key.write(&path, Existing::Replace)?;
        Ok(key)
    }

    /// A scene, loaded, varied and filmed when it is asked for first.
    fn scene(
        &mut self,
        device: &Device,
        source: &SceneSource,
        variant: Variant,
        size: FrameSize,
    ) -> Result<Rc<Scene>, EngineError> {
        let name = format!("{source:?} {variant:?} {size:?}");
        if let Some(scene) = self.filmed.get(&name) {
            return Ok(Rc::clone(scene));
        }
        let scene = Rc::new(Scene::open(device, source, variant, size)?);
        self.filmed.insert(name, Rc::clone(&scene));
        Ok(scene)
    }

    /// The study's other scenes, by name, as training sees this one.
    fn other_scenes(
        &mut self,
        device: &Device,
        marked: &SceneSource,
        arm: &Arm,
    ) -> Result<Vec<(String, Rc<Scene>)>, EngineError> {
        let side = arm.config.views.size_px.0;
        let size = FrameSize::new(side, side)?;
        let others: Vec<_> = self.sources.iter().filter(|source| *source != marked).cloned().collect();
        others
            .into_iter()
            .map(|source| Ok((source.to_string(), self.scene(device, &source, Variant::AsIs, size)?)))
            .collect()
    }
}

impl Marked<'_> {
    /// Films and reads.
    fn read(&self, take: &Take, witnesses: &Witnesses<'_>) -> Result<(Evaluation, CrossExamination), EngineError> {
        let Subject { device, clip, key, message, .. } = self.subject;
        let held_out = self.film(take)?;
        let extractor = &self.embedded.extractor;
        let mut evaluation = held_out.evaluate(device, clip, key, extractor, message)?;
        if let Some(term) = &self.arm.config.objective.lpips {
            evaluation.lpips = Some(held_out.lpips(&Lpips::new(device, term.network.get()?, term.input)?)?);
        }
        Ok((evaluation, cross_examine(&self.subject, extractor, &held_out, witnesses)?))
    }

    fn film(&self, take: &Take) -> Result<HeldOut, EngineError> {
        let Scene { model, look_at, cameras, .. } = self.scene;
        let size_px = self.arm.config.views.size_px;
        let size = FrameSize::new(size_px.0, size_px.1)?;
        let device = self.subject.device;
        let shoot = |strength: f32, cameras: &CameraSet| {
            let sh_coeffs = self.embedded.with_strength(&model.gaussians.sh_coeffs, strength);
            HeldOut::render(device, model, &sh_coeffs, cameras)
        };
        let all_times = scene::times(0.0, 1.0);
        let copied = || Ok::<_, EngineError>(cameras.clone().resized(FrameSize::new(COPY_PX, COPY_PX)?));
        match *take {
            Take::Plain => shoot(1.0, cameras),
            Take::Distorted(distortion) => {
                let mut attack = DistortionChain::new(device, (COPY_PX, COPY_PX), &[distortion], self.arm.config.seed)?;
                shoot(1.0, &copied()?)?
                    .changed(|clip| (0..).zip(clip).map(|(number, frame)| attack.apply(frame, number)).collect())
            }
            Take::H264(crf) => shoot(1.0, &copied()?)?.changed(|clip| through_h264(clip, crf)),
            Take::Strength(factor) => shoot(factor, cameras),
            Take::Frames(count) => shoot(1.0, cameras)?.changed(|clip| Ok(spread(clip, count))),
            Take::Elevation(degrees) => shoot(1.0, &scene::orbit(size, degrees, *look_at)?.at_times(&all_times)),
            Take::Distance(factor) => {
                let cameras =
                    scene::orbit(size, ORBIT_ELEVATION_DEG, LookAt { radius: factor * look_at.radius, ..*look_at })?;
                shoot(1.0, &cameras.at_times(&all_times))
            }
            Take::Times(first, last) => {
                let cameras = scene::orbit(size, ORBIT_ELEVATION_DEG, *look_at)?;
                shoot(1.0, &cameras.at_times(&scene::times(first, last)))
            }
            Take::Size(width, height) => {
                let cameras = scene::orbit(FrameSize::new(width, height)?, ORBIT_ELEVATION_DEG, *look_at)?;
                shoot(1.0, &cameras.at_times(&all_times))
            }
        }
    }

    /// Adds what other copies say, and what a forger makes of clean clips.
    fn contested(
        &self,
        row: Row,
        fitted: &ExtractorWeights,
        rival: &Key,
        watch: Watcher<'_>,
    ) -> Result<Row, EngineError> {
        let swap = self.swap(&mut *watch)?;
        let other = self.other_owner(rival, watch)?;
        let row = Row {
            swap_second: Some(swap.second.share()),
            swap_first: Some(swap.first.share()),
            other_owner: other.as_ref().map(|other| other.all.share()),
            other_owner_in_band: other.as_ref().map(|other| other.all.state == ControlState::Quiet),
            ..row
        };
        match self.arm.config.mode() {
            ExtractorMode::Joint => self.forged(row, fitted, rival),
            // Without a network there is nothing to train.
            _ => Ok(row),
        }
    }

    /// A second copy with another message, optimised through the first one's frozen extractor.
    fn swap(&self, watch: Watcher<'_>) -> Result<Swap, EngineError> {
        let subject = &self.subject;
        let extractor: &ExtractorWeights = &self.embedded.extractor;
        let message = swap_message(subject.message, subject.key);
        let second = Subject { message: &message, ..*subject };
        let start = Start::Frozen(extractor);
        let copy = train(Embedding::prepare_with(second, self.scene.framed(&self.arm.config), start)?, watch)?;
        let held_out = HeldOut::render(subject.device, &self.scene.model, &copy.sh_coeffs, &self.scene.cameras)?;
        read_swap(subject, extractor, &held_out, &message)
    }

    /// The same asset as another owner marks it.
    fn other_owner(&self, rival: &Key, watch: Watcher<'_>) -> Result<Option<OtherOwners>, EngineError> {
        let subject = &self.subject;
        let message = rival.own_message();
        let theirs = Subject { message: &message, key: rival, ..*subject };
        let copy = train(Embedding::prepare(theirs, self.scene.framed(&self.arm.config))?, watch)?;
        let held_out = HeldOut::render(subject.device, &self.scene.model, &copy.sh_coeffs, &self.scene.cameras)?;
        let owners = [OtherOwner { name: "rival", clips: &held_out.marked }];
        read_other_owners(subject, &self.embedded.extractor, &owners)
    }

    /// What an accuser makes clean clips say afterwards, and what a verifier makes of that.
    fn forged(&self, row: Row, fitted: &ExtractorWeights, rival: &Key) -> Result<Row, EngineError> {
        let forgery = forge(&self.subject, fitted, &self.scene.clean, &ForgeConfig::default())?;
        let clean = self.film(&Take::Strength(0.0))?;
        let witnesses = Witnesses { scenes: &[], other_key: rival, untrained: None };
        let examined = cross_examine(&self.subject, &forgery.extractor, &clean, &witnesses)?;
        Ok(Row { forged: Some(forgery.said.share()), forged_verdict: in_words(examined.evidence.verdict), ..row })
    }
}

/// The seed of an arm's key.
fn seed_of(arm: &Arm) -> u8 {
    u8::try_from(arm.config.seed).unwrap_or(u8::MAX)
}

/// Takes all steps.
fn train(mut embedding: Embedding<'_>, watch: Watcher<'_>) -> Result<Embedded, EngineError> {
    while embedding.step()?.is_some() {
        watch(Step::Training(embedding.step_number()))?;
    }
    embedding.finish()
}

/// `count` frames of a clip, evenly spaced.
fn spread(clip: &[Frame], count: usize) -> Vec<Frame> {
    let count = count.min(clip.len());
    (0..count).map(|i| clip[i * clip.len() / count].clone()).collect()
}

/// A clip as it comes out of a video file.
fn through_h264(clip: &[Frame], crf: u8) -> Result<Vec<Frame>, EngineError> {
    let folder = tempfile::tempdir().map_err(|source| EngineError::Io { path: std::env::temp_dir(), source })?;
    let path = folder.path().join("clip.mp4");
    write_video(&path, clip, &EncodeOptions { crf: Some(crf), odd_size: OddSize::Extend, ..EncodeOptions::default() })?;
    let frames = read_clip(&path, &ReadOptions::default())?.frames().to_vec();
    // An odd side came back longer by a pixel.
    let (width, height) = clip.first().map_or((0, 0), |frame| (frame.width(), frame.height()));
    frames.into_iter().map(|frame| cropped(&frame, width, height)).collect()
}

fn cropped(frame: &Frame, width: u32, height: u32) -> Result<Frame, EngineError> {
    let rows = frame.rgb().chunks_exact(3 * frame.width() as usize).take(height as usize);
    Frame::new(width, height, rows.flat_map(|row| row[..3 * width as usize].to_vec()).collect())
}

/// Whether an error says something about the method, and not about the machine.
fn is_a_result(error: &EngineError) -> bool {
    match error {
        EngineError::Usage { .. } | EngineError::NotFinite { .. } | EngineError::BadData { .. } => true,
        EngineError::Kernel(error) => {
            matches!(error, KernelError::OverBudget { .. } | KernelError::Allocation { .. } | KernelError::Shape { .. })
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(count: u8) -> Vec<Frame> {
        (0..count).map(|i| Frame::new(1, 1, vec![i; 3]).expect("one pixel")).collect()
    }

    #[test]
    fn frames_are_spread_over_a_clip() {
        let firsts = |clip: Vec<Frame>| clip.iter().map(|f| f.rgb()[0]).collect::<Vec<_>>();
        assert_eq!(firsts(spread(&frames(8), 4)), [0, 2, 4, 6], "every other");
        assert_eq!(firsts(spread(&frames(8), 1)), [0], "one");
        assert_eq!(firsts(spread(&frames(3), 8)), [0, 1, 2], "no more than there are");
    }

    #[test]
    fn a_video_of_odd_size_comes_back_in_its_size() {
        let clip: Vec<_> = (0..3).map(|i| Frame::new(33, 17, vec![40 * i; 33 * 17 * 3]).expect("a frame")).collect();
        let back = through_h264(&clip, 12).expect("ffmpeg runs");
        assert_eq!(back.len(), clip.len(), "frames");
        for (got, want) in back.iter().zip(&clip) {
            assert_eq!((got.width(), got.height()), (33, 17), "size");
            let worst = got.rgb().iter().zip(want.rgb()).map(|(g, w)| g.abs_diff(*w)).max();
            // A grey picture takes one rounding to limited range and one back.
            assert!(worst.is_some_and(|d| d <= 3), "colours: {worst:?}");
        }
    }
}
