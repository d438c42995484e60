//! One step of the embedding, by the clock on the wall: what a user waits for.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::time::Instant;

use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::demo::{BITS, Scene};
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile, Repetition, Subject};
use guard4d_engine::watermark::evidence::ExtractorMode;
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::message::Message;
use guard4d_engine::watermark::prf::MasterSecret;
use guard4d_kernels::Device;

use crate::Outcome;
use crate::harness::{Bench, Work};

const SECRET: [u8; 32] = [7; 32];
/// Steps whose recording is timed, of each kind.
const RECORDINGS: usize = 30;

/// An owner, made when the first row needs one: half a minute that other rows do not have to wait for.
pub(crate) struct Owner {
    pub(crate) key: Key,
    pub(crate) message: Message,
}

impl Owner {
    pub(crate) fn new(device: &Device, clip: &Clip) -> Result<Self, EngineError> {
        let (key, _) = Key::generate(device, clip, MasterSecret::from_bytes(SECRET), BITS)?;
        Ok(Self { message: key.own_message(), key })
    }
}

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let device = bench.device.clone();
    let clip = Clip::load(&device, &ClipSource::Mini)?;
    let scene = Scene::unpack()?;
    let model = Model::open(scene.path())?;
    let owner = OnceCell::new();
    let prepare = |mode, side| {
        let Owner { key, message } = match owner.get() {
            Some(owner) => owner,
            None => {
                let new = Owner::new(&device, &clip)?;
                owner.get_or_init(|| new)
            }
        };
        let subject = Subject { device: &device, clip: &clip, key, model: &model, message };
        // Few clips and responses: they cost preparation, not steps. No end, so that every sample is a step, and no
        // measurement on held-out clips, so that none is more than a step.
        let few = EmbedConfig {
            steps: usize::MAX,
            views: 4,
            responses: 2 * BITS as usize,
            held_out_every: 0,
            ..EmbedConfig::new(Profile::Draft, mode)
        };
        Embedding::prepare(subject, EmbedConfig { size_px: (side, side), ..few })
    };
    for mode in [ExtractorMode::None, ExtractorMode::Blind, ExtractorMode::Joint] {
        for side in [200, 400] {
            let name = format!("embed/step demo scene, {mode}, 8x{side}x{side}, wall clock");
            // Device seconds before the first step that counts, and after the last.
            let (mut embedding, mut before, mut after, mut steps) = (None, None, BTreeMap::new(), 0.0);
            let row = bench.samples(&name, Work::Mixed, || {
                let embedding = match &mut embedding {
                    Some(embedding) => embedding,
                    None => embedding.insert(prepare(mode, side)?),
                };
                let started = Instant::now();
                embedding.step()?;
                let elapsed = started.elapsed();
                after = embedding.part_seconds();
                steps = (embedding.step_number() - 1) as f64;
                before.get_or_insert_with(|| after.clone());
                Ok(elapsed)
            })?;
            let (Some(row), Some(before)) = (row, before) else { continue };
            row.stages = after.into_iter().map(|(part, seconds)| (part, (seconds - before[&part]) / steps)).collect();
        }
        recording(bench, mode, || prepare(mode, 200))?;
    }
    Ok(())
}

/// Host time of recording a step whose repeated passes are replayed, and of one that is recorded anew, by turns.
fn recording<'a>(
    bench: &mut Bench,
    mode: ExtractorMode,
    prepare: impl FnOnce() -> Result<Embedding<'a>, EngineError>,
) -> Outcome {
    let name = |kind: &str| format!("embed/record a step, {mode}, {kind}, wall clock");
    let kinds = [(Repetition::RecordedAnew, name("anew")), (Repetition::Replayed, name("replayed"))];
    if !kinds.iter().any(|(_, name)| bench.wants(name)) {
        return Ok(());
    }
    let mut embedding = prepare()?;
    let mut seconds = kinds.each_ref().map(|_| Vec::new());
    // In the first steps pipelines are made, and what is replayed is recorded.
    for turn in 0..=RECORDINGS {
        for ((how, _), seconds) in kinds.iter().zip(&mut seconds) {
            embedding.repeat(*how);
            embedding.step()?;
            if turn > 0 {
                seconds.push(embedding.recording_time().as_secs_f64());
            }
        }
    }
    for ((_, name), seconds) in kinds.into_iter().zip(seconds) {
        bench.host_times(name, seconds);
    }
    Ok(())
}
