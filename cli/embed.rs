//! `guard4d embed`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytesize::ByteSize;
use guard4d_engine::EngineError;
use guard4d_engine::clip::{Clip, ClipSource};
use guard4d_engine::lpips::{LpipsInput, LpipsWeights};
use guard4d_engine::output::{AtomicDir, Existing};
use guard4d_engine::render::OffsetBases;
use guard4d_engine::scene::{CameraSet, Model};
use guard4d_engine::tensor_file::TensorFile;
use guard4d_engine::watermark::delivery::{self, Delivery};
use guard4d_engine::watermark::embed::{
    EmbedConfig, Embedded, Embedding, Estimate, HeldOutReport, Left, Look, LpipsTerm, Profile, RungReport, StepReport,
    Subject,
};
use guard4d_engine::watermark::evaluate::Evaluation;
use guard4d_engine::watermark::evidence::ExtractorMode;
use guard4d_engine::watermark::gate::{Gate, Shortfall};
use guard4d_engine::watermark::general::GeneralExtractor;
use guard4d_engine::watermark::id_code::IdBits;
use guard4d_engine::watermark::key::Key;
use guard4d_engine::watermark::message::{Message, Payload};
use guard4d_engine::watermark::undo;
use guard4d_kernels::Device;
use guard4d_kernels::vk::MemoryUse;
use serde::Serialize;

use crate::args::{
    BasesArg, Common, EffortArgs, EmbedArgs, ExtractorArg, FitArg, LpipsArgs, LpipsInputArg, ObjectiveArgs, ProfileArg,
};
use crate::progress::bar;
use crate::report::{Outcome, Row, cost_rows, evidence_in_words, percent, print, reading_rows, say, table};
use crate::views::{cameras, vantage};
use crate::{devices, model, stop};

/// What `--json` prints.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    evidence: &'static str,
    missed: &'a [Shortfall],
    seconds: &'a BTreeMap<String, f64>,
    /// What clips that training never sees showed meanwhile.
    looks: &'a [Look],
    /// What each rung bought; empty with `--fit full`.
    rungs: &'a [RungReport],
    /// Most device memory taken from the driver at one time.
    peak_memory_bytes: u64,
    /// Most of it that was in use at one time; the rest lay idle in blocks.
    peak_used_bytes: u64,
}

pub(crate) fn run(args: &EmbedArgs, common: &Common) -> Result<Outcome, EngineError> {
    let existing = if args.overwrite { Existing::Replace } else { Existing::Refuse };
    if let Some(file) = &args.undo {
        undo::restore(&args.model, file, &args.out, existing)?;
        return Ok(Outcome::Done);
    }
    if args.dry_run {
        return dry_run(&Inputs::open(args, common)?, common);
    }
    stop::listen(common);
    let out = AtomicDir::create(&args.out, existing)?;
    let inputs = Inputs::open(args, common)?;
    let Inputs { gate, cameras, config, .. } = &inputs;
    let subject = inputs.subject();
    let checkpoint = checkpoint_path(&args.out);
    if args.resume {
        // What cannot be read is told before the views are planned.
        TensorFile::read(&checkpoint)?;
    }
    let mut embedding = Embedding::prepare(subject, config.clone())?;
    if args.resume {
        embedding.restore(&checkpoint)?;
    }
    let embedded = train(embedding, common, Some((&checkpoint, args.checkpoint_every)))?;
    let delivery = Delivery { subject, config, embedded: &embedded, input: &args.model, payload: inputs.payload };
    let (evaluation, _) = delivery::write(out.path(), &delivery, cameras)?;
    out.commit()?;
    remove_checkpoint(&checkpoint);
    let missed = gate.missed(&evaluation);
    let seconds = &embedded.seconds;
    let evidence = evidence_in_words(evaluation.mode, evaluation.mixing.of > 1);
    let MemoryUse { peak_reserved_bytes: peak_memory_bytes, peak_bytes: peak_used_bytes, .. } =
        inputs.device.memory_use();
    let result = Printed {
        evaluation: &evaluation,
        evidence,
        missed: &missed,
        seconds,
        looks: &embedded.looks,
        rungs: &embedded.rungs,
        peak_memory_bytes,
        peak_used_bytes,
    };
    print(common, &result, |result| {
        let costs = cost_rows(result.evaluation, result.seconds, result.peak_memory_bytes);
        table(&[reading_rows(result.evaluation), rung_rows(result.rungs), costs].concat())
    })?;
    Ok(judge(&missed))
}

/// What each rung bought, for people.
fn rung_rows(rungs: &[RungReport]) -> Vec<Row> {
    let row = |rung: &RungReport| {
        let RungReport { splats, offsets, views, steps, left, look } = rung;
        let why = match left {
            Left::Enough => "enough",
            Left::Flat => "no more progress",
            Left::Steps => "out of steps",
        };
        let (bits, proven, psnr) = (percent(look.clip_accuracy.into()), percent(look.proven.into()), look.psnr.0);
        let what = format!("{offsets} offsets on {splats} splats, {views} clips, {steps} steps: {why}");
        ("rung", format!("{what}; held out: bits right {bits}, clips that prove it alone {proven}, {psnr:.2} dB"))
    };
    rungs.iter().map(row).collect()
}

/// What the command line names, opened and checked.
struct Inputs {
    device: Device,
    clip: Clip,
    key: Key,
    model: Model,
    message: Message,
    payload: Option<IdBits>,
    cameras: CameraSet,
    config: EmbedConfig,
    gate: Gate,
}

impl Inputs {
    fn open(args: &EmbedArgs, common: &Common) -> Result<Self, EngineError> {
        let device = devices::open(common)?;
        let clip = devices::load_clip(&device, &ClipSource::from_argument(&args.clip), common)?;
        let key = Key::read(args.key.as_ref().expect("clap requires it without --undo"), &clip)?;
        let bits = u32::try_from(key.bits()).unwrap_or(u32::MAX);
        let payload = Payload::parse(&args.message, bits)?;
        let config = config(args)?;
        let searched = payload.id_bits().map_or(1, IdBits::num_ids).saturating_mul(config.mixings);
        let gate = gate(args, key.bits(), searched)?;
        let config = match args.fit {
            FitArg::Auto => config.climbing(gate.aim(), key.bits()),
            FitArg::Full => config,
        };
        let open = if args.lossy { model::open_lossy } else { model::open };
        let model = open(&args.model, common)?;
        // Files that cannot be written in place are refused before the work, not after it.
        model.check_writable()?;
        let message = payload.message(&key.prf())?;
        let (payload, cameras) = (payload.id_bits(), cameras(&args.views, &model)?);
        let config = EmbedConfig { vantage: vantage(&args.views, &model), ..config };
        Ok(Self { device, clip, key, model, message, payload, cameras, config, gate })
    }

    fn subject(&self) -> Subject<'_> {
        let Self { device, clip, key, model, message, .. } = self;
        Subject { device, clip, key, model, message }
    }
}

/// Says what the embedding would take.
fn dry_run(inputs: &Inputs, common: &Common) -> Result<Outcome, EngineError> {
    let estimate = Estimate::of(inputs.subject(), &inputs.config)?;
    print(common, &estimate, |e| {
        let size = |bytes: u64| ByteSize(bytes).to_string();
        let clips = match e.clips_in_memory {
            all if all == e.clips => format!("{} of {} each, all in memory", e.clips, size(e.clip_bytes)),
            some => format!("{} of {} each, {some} in memory at a time", e.clips, size(e.clip_bytes)),
        };
        let seconds = format!("plan {:.0}, fit {:.0}, train {:.0}", e.plan_seconds, e.fit_seconds, e.train_seconds);
        table(&[
            ("splats", e.splats.to_string()),
            ("clips", clips),
            ("everything else", size(e.resident_bytes)),
            ("device memory at its peak", size(e.peak_memory_bytes)),
            ("budget", e.budget_bytes.map_or("none".to_owned(), size)),
            ("seconds, about", seconds),
        ])
    })?;
    Ok(Outcome::Done)
}

/// Says what fell short; the outputs stay.
fn judge(missed: &[Shortfall]) -> Outcome {
    for shortfall in missed {
        say(&format!("quality gate missed: {shortfall}"));
    }
    if missed.is_empty() { Outcome::Done } else { Outcome::Negative }
}

/// What flags ask of the result, or what a message of its length needs that is one of so many claims.
fn gate(args: &EmbedArgs, bits: usize, searched: u32) -> Result<Gate, EngineError> {
    let mut gate = Gate { min_psnr_db: args.min_psnr, ..Gate::after_search(bits, searched) };
    if let Some(share) = args.min_accuracy {
        (gate.min_proven, gate.min_accuracy) = (0.0, Some(share));
    }
    gate.validate()?;
    Ok(gate)
}

/// The profile's numbers with what flags change.
fn config(args: &EmbedArgs) -> Result<EmbedConfig, EngineError> {
    let profile = match args.profile {
        ProfileArg::Draft => Profile::Draft,
        ProfileArg::Balanced => Profile::Balanced,
        ProfileArg::Faithful => Profile::Faithful,
        ProfileArg::Guardsplat => Profile::Guardsplat,
        ProfileArg::MultiFrame => Profile::MultiFrame,
    };
    let mode = match args.extractor {
        None => profile.default_mode(),
        Some(ExtractorArg::None) => ExtractorMode::None,
        Some(ExtractorArg::Blind) => ExtractorMode::Blind,
        Some(ExtractorArg::General) => ExtractorMode::General,
        Some(ExtractorArg::Joint) => ExtractorMode::Joint,
    };
    let mut config = EmbedConfig { seed: args.seed, size_px: args.views.size(), ..EmbedConfig::new(profile, mode) };
    config.bases = match args.bases {
        None => config.bases,
        Some(BasesArg::Dc) => OffsetBases::Dc,
        Some(BasesArg::All) => OffsetBases::All,
    };
    config.fov_deg = f64::from(args.views.fov);
    config.control_every = args.control_every;
    config.tmsd_held = args.tmsd_held.unwrap_or(config.tmsd_held);
    config.distortions.clone_from(&args.distortions);
    spend(&args.effort, &mut config);
    if let Some(target) = args.target_psnr {
        config = config.with_target(target);
    }
    aim(&args.objective, &mut config);
    config.max_offset = args.max_offset.or(config.max_offset);
    config.reach = args.reach.unwrap_or(config.reach);
    config.lpips = lpips(&args.lpips)?;
    if args.general.is_some() || mode == ExtractorMode::General {
        config.general = Some(Arc::new(GeneralExtractor::open(args.general.as_deref())?));
    }
    Ok(config)
}

/// The network that flags name, and what is done with it.
fn lpips(args: &LpipsArgs) -> Result<Option<LpipsTerm>, EngineError> {
    let Some(path) = &args.lpips else { return Ok(None) };
    Ok(Some(LpipsTerm {
        weights: Arc::new(LpipsWeights::read(path)?),
        input: match args.lpips_input {
            LpipsInputArg::Canonical => LpipsInput::Canonical,
            LpipsInputArg::Unit => LpipsInput::UnitFed,
        },
        lambda: args.lambda_lpips,
        crop_px: args.lpips_crop,
        every: args.lpips_every,
    }))
}

/// Replaces what a profile aims at by what flags say.
fn aim(objective: &ObjectiveArgs, config: &mut EmbedConfig) {
    let numbers = [
        (objective.lambda_msg, &mut config.lambda_msg),
        (objective.lambda_recon, &mut config.lambda_recon),
        (objective.lambda_ssim, &mut config.lambda_ssim),
        (objective.lambda_offset, &mut config.lambda_offset),
        (objective.lambda_control, &mut config.lambda_control),
        (objective.lr_dc, &mut config.lr_dc),
        (objective.lr_rest_share, &mut config.lr_rest_share),
        (objective.lr_floor, &mut config.lr_floor),
        (objective.margin, &mut config.margin),
    ];
    for (given, number) in numbers {
        *number = given.unwrap_or(*number);
    }
    config.control = objective.control.unwrap_or(config.control);
}

/// Replaces what a profile spends by what flags say.
pub(crate) fn spend(effort: &EffortArgs, config: &mut EmbedConfig) {
    if let Some(steps) = effort.steps {
        config.steps = steps as usize;
    }
    if let Some(clips) = effort.train_clips {
        config.views = clips;
    }
    if let Some(responses) = effort.responses {
        config.responses = responses as usize;
    }
    config.mixings = effort.mixings.unwrap_or(config.mixings);
}

/// Steps until done or stopped; with a checkpoint file, a stop leaves a valid one, and so does the end.
pub(crate) fn train(
    mut embedding: Embedding<'_>,
    common: &Common,
    checkpoint: Option<(&Path, u64)>,
) -> Result<Embedded, EngineError> {
    let progress = bar(common, embedding.progress().1 as u64);
    let mut saved = Instant::now();
    let mut held_out = None;
    loop {
        if stop::is_requested() {
            progress.abandon();
            let Some((path, _)) = checkpoint else { return Err(EngineError::Stopped) };
            embedding.save(path)?;
            return Err(EngineError::Interrupted { checkpoint: path.to_owned() });
        }
        let Some(report) = embedding.step()? else { break };
        progress.set_position(embedding.progress().0 as u64);
        held_out = report.held_out.or(held_out);
        progress.set_message(state(&report, held_out));
        if let Some((path, every)) = checkpoint
            && saved.elapsed() >= Duration::from_secs(every)
        {
            embedding.save(path)?;
            saved = Instant::now();
        }
    }
    // Measuring the result takes a while, too; whoever stops that need not train again.
    if let Some((path, _)) = checkpoint {
        embedding.save(path)?;
    }
    progress.finish_and_clear();
    embedding.finish()
}

/// What the bar says: the newest loss, and the newest figures on clips that are not trained on.
fn state(report: &StepReport, held_out: Option<HeldOutReport>) -> String {
    let loss = report.message;
    if let Some(number) = report.mixing {
        return format!("trying mixing {}  loss {loss:.3}", number + 1);
    }
    let figures = held_out.map(|h| format!("  held out: bits {:.0} %, {:.1} dB", 100.0 * h.bit_accuracy, h.psnr));
    format!("loss {loss:.3}{}", figures.unwrap_or_default())
}

/// Beside the output folder, so that an unfinished run leaves nothing in it.
pub(crate) fn checkpoint_path(out: &Path) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(".checkpoint.safetensors");
    out.with_file_name(name)
}

/// A finished run's checkpoint has no use; one that cannot be removed does no harm.
pub(crate) fn remove_checkpoint(path: &Path) {
    if let Err(error) = std::fs::remove_file(path)
        && error.kind() != std::io::ErrorKind::NotFound
    {
        tracing::warn!("{}: {error}", path.display());
    }
}
