//! What makes an embedding faster, beside what it costs in accuracy: one embedding per variant and seed, read from 8-bit
//! frames of unseen views and times as all of the study.

use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use cpu_time::ProcessTime;
use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource, Precision};
use guard4d_engine::demo;
use guard4d_engine::output::{AtomicFile, Existing};
use guard4d_engine::scene::{CameraSet, ImageSize, Model};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedding, Estimate, Subject};
use guard4d_engine::watermark::evaluate::{Evaluation, HeldOut};
use guard4d_engine::watermark::evidence::ExtractorMode;
use guard4d_kernels::{Device, DeviceOptions};

use crate::Args;
use crate::host;
use crate::measure::{config, key, train};

/// A tight budget leaves room for one clip in this many: with half of them, every other request makes one again.
const TIGHT_DIVISOR: usize = 2;
/// Steps from one control to the next that are tried.
const CONTROL_EVERY: [u32; 3] = [1, 2, 4];
const COLUMNS: &str = "mode,precision,control_every,plans,model,size_px,bits,clips,target_db,seed,steps,clips_made,\
                       plan_s,fit_s,train_s,wall_s,cpu_s,train_cpu_s,marked,clean,noisy,psnr_db,budget_mib,peak_mib,\
                       load,device,commit";

/// Where frame plans are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Plans {
    /// All in memory.
    Kept,
    /// In memory as far as a budget goes; the others are made again.
    MadeAgain,
}

/// One way to embed.
#[derive(Clone, Copy, Debug)]
struct Variant {
    mode: ExtractorMode,
    precision: Precision,
    control_every: u32,
    plans: Plans,
}

/// The plain way of each mode, and everything that is compared with it.
fn variants(device: &Device) -> Vec<Variant> {
    let plain = |mode| Variant { mode, precision: Precision::F32, control_every: 1, plans: Plans::Kept };
    let blind = plain(ExtractorMode::Blind);
    let half = device.info().cooperation.map(|_| Precision::Half);
    let precisions = [Precision::F32, Precision::Fixed16].into_iter().chain(half);
    let mut variants: Vec<_> = precisions.map(|precision| Variant { precision, ..blind }).collect();
    variants.push(Variant { plans: Plans::MadeAgain, ..blind });
    variants.extend(CONTROL_EVERY.map(|control_every| Variant { control_every, ..plain(ExtractorMode::Joint) }));
    variants
}

/// A model with a name and unseen views.
struct Scene {
    name: String,
    model: Model,
    cameras: CameraSet,
}

/// What one embedding took and gave.
struct Outcome {
    config: EmbedConfig,
    evaluation: Evaluation,
    stages: [f64; 3],
    clips_made: usize,
    wall_s: f64,
    cpu_s: f64,
    train_cpu_s: f64,
    budget: Option<u64>,
    peak: u64,
}

/// Embeds in every variant with every seed and fidelity; adds a row to `speed.csv` after each.
///
/// # Errors
/// When the device fails; [`EngineError::Io`] naming the file.
pub(crate) fn run(args: &Args) -> Result<(), EngineError> {
    let device = open(args)?;
    let folder = args.out.clone().unwrap_or_else(|| host::results(&device));
    let (variants, name) = (variants(&device), device.info().name.clone());
    drop(device);
    let path = folder.join("speed.csv");
    AtomicFile::write(&path, Existing::Replace, format!("{COLUMNS}\n").as_bytes())?;
    let scenes = scenes(args)?;
    // Variants innermost: a machine that slows down slows them all down.
    for &seed in &args.seeds {
        for scene in &scenes {
            for &target_psnr in &args.psnr {
                for variant in &variants {
                    let load = host::load();
                    let outcome = embed(args, scene, *variant, (target_psnr, seed))?;
                    let row = row(&scene.name, *variant, &outcome);
                    eprintln!("{row}");
                    append(&path, &format!("{row},{load},\"{name}\",{}\n", host::commit()))?;
                }
            }
        }
    }
    eprintln!("{}", path.display());
    Ok(())
}

fn open(args: &Args) -> Result<Device, EngineError> {
    let options = DeviceOptions { kernels: args.kernels, ..DeviceOptions::default() };
    Ok(Device::open_with(&args.device, options)?)
}

/// The models that are named, or else the built-in one.
fn scenes(args: &Args) -> Result<Vec<Scene>, EngineError> {
    let size = ImageSize::new(args.size, args.size)?;
    let scene = |path: &Path, name: String| {
        let cameras = CameraSet::open(&path.join("transforms_test.json"), size)?;
        Ok(Scene { name, model: Model::open(path)?, cameras })
    };
    if args.models.is_empty() {
        let built_in = demo::Scene::unpack()?;
        return Ok(vec![scene(built_in.path(), "built-in".to_owned())?]);
    }
    let name = |path: &Path| path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    args.models.iter().map(|path| scene(path, name(path))).collect()
}

/// One embedding on a device of its own, so that its memory is its own.
fn embed(args: &Args, scene: &Scene, variant: Variant, (target_psnr, seed): (f32, u8)) -> Result<Outcome, EngineError> {
    let plain = config(args, (variant.mode, target_psnr), seed);
    let config = EmbedConfig { control_every: variant.control_every, ..plain };
    let prepare = || -> Result<_, EngineError> {
        let device = open(args)?;
        let clip = Clip::load(&device, &ClipSource::from_argument(&args.clip))?.in_precision(variant.precision);
        let key = key(args, (&device, &clip), seed)?;
        Ok((device, clip, key))
    };
    let budget = match variant.plans {
        Plans::Kept => None,
        Plans::MadeAgain => {
            let (device, clip, key) = prepare()?;
            let message = key.own_message();
            let subject = Subject { device: &device, clip: &clip, key: &key, model: &scene.model, message: &message };
            let estimate = Estimate::of(subject, &config)?;
            let clips = estimate.clips.div_ceil(TIGHT_DIVISOR) as u64;
            Some(estimate.resident_bytes + clips * estimate.clip_bytes)
        }
    };
    let (device, clip, key) = prepare()?;
    if let Some(bytes) = budget {
        device.limit_memory(bytes);
    }
    let message = key.own_message();
    let subject = Subject { device: &device, clip: &clip, key: &key, model: &scene.model, message: &message };
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    let embedding = Embedding::prepare(subject, config.clone())?;
    let cpu_before_training = cpu.elapsed();
    let embedded = train(embedding, &scene.name)?;
    let (wall_s, cpu) = (wall.elapsed().as_secs_f64(), cpu.elapsed());
    let peak = device.memory_use().peak_reserved_bytes;
    let held_out = HeldOut::shoot(&device, &scene.model, &embedded.sh_coeffs, &scene.cameras)?;
    Ok(Outcome {
        evaluation: held_out.evaluate(&device, &clip, &key, &embedded.extractor, &message)?,
        stages: ["plan", "fit", "train"].map(|stage| embedded.seconds.get(stage).copied().unwrap_or(f64::NAN)),
        clips_made: embedded.clips_made,
        wall_s,
        cpu_s: cpu.as_secs_f64(),
        train_cpu_s: (cpu - cpu_before_training).as_secs_f64(),
        budget,
        peak,
        config,
    })
}

/// Cells in the order of [`COLUMNS`], without those of the machine.
fn row(model: &str, variant: Variant, outcome: &Outcome) -> String {
    let Variant { mode, precision, control_every, plans } = variant;
    let Outcome { config, evaluation: read, stages, clips_made, wall_s, cpu_s, train_cpu_s, budget, peak } = outcome;
    let plans = match plans {
        Plans::Kept => "kept",
        Plans::MadeAgain => "made again",
    };
    let mib = |bytes: u64| format!("{:.0}", bytes as f64 / f64::from(1 << 20));
    let [plan, fit, train] = stages.map(|seconds| format!("{seconds:.2}"));
    let EmbedConfig { steps, views, target_psnr, seed, size_px: (side, _), .. } = config;
    format!(
        "{mode},{},{control_every},{plans},{model},{side},{},{views},{target_psnr},{seed},{steps},{clips_made},\
         {plan},{fit},{train},{wall_s:.2},{cpu_s:.2},{train_cpu_s:.2},{:.4},{:.4},{:.4},{:.2},{},{}",
        precision.name(),
        read.bits,
        read.marked,
        read.clean,
        read.noisy,
        read.psnr.mean_of_views_db.0,
        budget.map(mib).unwrap_or_default(),
        mib(*peak),
    )
}

/// Adds a line, on disk before it returns.
fn append(path: &Path, line: &str) -> Result<(), EngineError> {
    let written = OpenOptions::new().append(true).open(path).and_then(|mut file| {
        file.write_all(line.as_bytes())?;
        file.sync_data()
    });
    written.map_err(|source| EngineError::Io { path: path.to_owned(), source })
}
