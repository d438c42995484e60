//! Device memory and time of embedding into large scenes within a budget.

use std::time::Instant;

use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::render::OffsetBases;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Gaussians, Model, Motion};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Profile, Subject};
use guard4d_kernels::splat::SH_FLOATS;
use guard4d_kernels::{Device, DeviceOptions, FamilySelect};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::owner::{BITS, Owner};
use crate::harness::{Bench, MemoryRow, Outcome};

/// Most device memory that these embeddings may take.
pub(crate) const BUDGET: u64 = 4 << 30;
pub(crate) const STEPS: usize = 3;
/// Training clips: enough to be planned, kept and drawn from, few enough to be done with.
pub(crate) const CLIPS: u32 = 4;
/// How far a copy of a splat lies from it at most, in scene units; the demo scene is some two units high.
const JITTER: f32 = 0.01;
const SEED: u64 = 1;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let scene = DemoScene::unpack()?;
    let model = Model::open(scene.path())?;
    let mut still = model.clone();
    still.motion = Motion::Still;
    for (model, kind, count, bases, named, side_px) in [
        (&still, "static", 1_000_000, OffsetBases::Dc, "DC", 400),
        (&still, "static", 1_000_000, OffsetBases::Dc, "DC", 800),
        (&still, "static", 1_000_000, OffsetBases::All, "all", 800),
        (&model, "moving", 300_000, OffsetBases::Dc, "DC", 400),
    ] {
        let count = bench.size(count, model.gaussians.len());
        let side_px = bench.size(side_px, 200);
        let what = format!("{kind} scene of {count} splats, offsets of {named} coefficients, {side_px} px");
        let name = format!("memory/embed {what}, blind");
        if bench.wants(&name) {
            let mut model = model.clone();
            model.gaussians = copies(&model.gaussians, count);
            println!("{name}");
            bench.memory.push(embed(&bench.device, &model, Work { bases, side_px }, name)?);
        }
    }
    Ok(())
}

/// As many splats: copies of those that are there, a little aside and smaller by as much as they are more.
#[allow(clippy::cast_precision_loss, reason = "a number of splats")]
fn copies(splats: &Gaussians, count: usize) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut aside = || JITTER * ((rng.next_u32() >> 8) as f32 / (1 << 23) as f32 - 1.0);
    let shrink = 0.5 * (count as f32 / splats.len() as f32).ln();
    let mut out = Gaussians { sh_degree: splats.sh_degree, ..Gaussians::default() };
    for i in (0..count).map(|i| i % splats.len()) {
        out.means.push(splats.means[i].map(|x| x + aside()));
        out.scales.push(splats.scales[i].map(|s| s - shrink));
        out.quats.push(splats.quats[i]);
        out.opacities.push(splats.opacities[i]);
        out.sh_coeffs.extend_from_slice(&splats.sh_coeffs[SH_FLOATS * i..SH_FLOATS * (i + 1)]);
    }
    out
}

/// What is embedded, and into which pictures.
#[derive(Clone, Copy)]
struct Work {
    bases: OffsetBases,
    side_px: u32,
}

/// A few steps on a device of their own, which the budget is for.
fn embed(like: &Device, model: &Model, work: Work, name: String) -> Result<MemoryRow, EngineError> {
    let select = format!("uuid:{}", like.info().uuid).parse().expect("a device's UUID selects it");
    let kernels = FamilySelect::Only(like.family());
    let device = Device::open_with(&select, DeviceOptions { kernels, ..DeviceOptions::default() })?;
    let clip = ClipModel::load(&device, &ClipSource::Mini)?;
    let Owner { key, message } = Owner::get(like, &ClipModel::load(like, &ClipSource::Mini)?)?;
    device.limit_memory(BUDGET);
    let few = EmbedConfig::new(Profile::Balanced, ExtractorMode::Blind).with(|c| {
        c.optimiser.steps = STEPS;
        c.views.clips = CLIPS;
        c.extractor.calibration_mut().expect("fitted").probes = BITS as usize;
        c.optimiser.held_out_every = 0;
        c.fidelity.bases = work.bases;
        c.views.size_px = (work.side_px, work.side_px);
    });
    let subject = Subject { device: &device, clip: &clip, key, model, message };
    let mut embedding = Embedding::prepare(subject, few)?;
    let started = Instant::now();
    while embedding.step()?.is_some() {}
    let step = started.elapsed().as_secs_f64() / STEPS as f64;
    let embedded = embedding.finish()?;
    let [plan, fit] = ["plan", "fit"].map(|stage| embedded.seconds[stage]);
    Ok(MemoryRow { name, used: device.memory_use(), seconds: [plan, fit, step] })
}
