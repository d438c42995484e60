//! One step of the embedding, by the clock on the wall: what a user waits for.

use std::time::Instant;

use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::demo::{self, BITS, Scene};
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Subject};
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::message::Payload;
use guard4d_engine::watermark::prf::MasterSecret;

use crate::Outcome;
use crate::harness::{Bench, Work};

const SECRET: [u8; 32] = [7; 32];

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let device = bench.device.clone();
    let clip = Clip::load(&device, &ClipSource::Mini)?;
    let scene = Scene::unpack()?;
    let model = Model::open(scene.path())?;
    let (key, _) = Key::generate(&device, &clip, MasterSecret::from_bytes(SECRET), BITS)?;
    let message = Payload::parse("random", BITS)?.message(&key.prf())?;
    let subject = Subject { device: &device, clip: &clip, key: &key, model: &model, message: &message };
    for side in [200, 400] {
        // Few clips and responses: they cost preparation, not steps. No end, so that every sample is a step.
        let few = EmbedConfig { steps: usize::MAX, views: 4, responses: 2 * BITS as usize, ..demo::config() };
        let mut embedding = Embedding::prepare(subject, EmbedConfig { size_px: (side, side), ..few })?;
        bench.samples(&format!("embed/step demo scene, blind, 8x{side}x{side}, wall clock"), Work::Mixed, || {
            let started = Instant::now();
            embedding.step()?;
            Ok(started.elapsed())
        })?;
    }
    Ok(())
}
