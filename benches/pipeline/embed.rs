//! One step of the embedding, by the clock on the wall: what a user waits for.

use std::collections::BTreeMap;
use std::time::Instant;

use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::scene::Model;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile, Repetition, Subject};

use super::owner::{BITS, Owner};
use crate::harness::{Bench, Outcome, Work};

/// Side of the pictures of steps whose recording is timed.
const RECORDED_PX: u32 = 200;
/// Steps whose recording is timed, of each kind.
const RECORDINGS: usize = 30;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let device = bench.device.clone();
    let clip = ClipModel::load(&device, &ClipSource::Mini)?;
    let scene = DemoScene::unpack()?;
    let model = Model::open(scene.path())?;
    let prepare = |mode, side| {
        let Owner { key, message } = Owner::get(&device, &clip)?;
        let subject = Subject { device: &device, clip: &clip, key, model: &model, message };
        // Few clips and responses: they cost preparation, not steps. No end, so that every sample is a step, and no
        // measurement on held-out clips, so that none is more than a step.
        let few = EmbedConfig::new(Profile::Draft, mode).with(|c| {
            c.optimiser.steps = usize::MAX;
            c.views.clips = 4;
            c.extractor.calibration_mut().expect("fitted").probes = 2 * BITS as usize;
            c.optimiser.held_out_every = 0;
        });
        Embedding::prepare(subject, few.with(|c| c.views.size_px = (side, side)))
    };
    for mode in [ExtractorMode::None, ExtractorMode::Blind, ExtractorMode::Joint] {
        for &side in bench.size(&[RECORDED_PX, 400][..], &[RECORDED_PX]) {
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
            if let (Some(row), Some(before)) = (row, before) {
                let stages = after.into_iter().map(|(part, seconds)| (part, (seconds - before[&part]) / steps));
                row.stages = stages.collect();
            }
            if side == RECORDED_PX {
                recording(bench, mode, || embedding.map_or_else(|| prepare(mode, side), Ok))?;
            }
        }
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
    for turn in 0..=bench.size(RECORDINGS, 1) {
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
