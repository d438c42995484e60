//! `guard4d embed`

use std::collections::BTreeMap;
use std::time::Duration;

use bytesize::ByteSize;
use guard4d_engine::base::checkpoint;
use guard4d_engine::base::output::AtomicDir;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::device::MemoryUse;
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::forecast::Trial;
use guard4d_engine::release::delivery::{self, Delivery};
use guard4d_engine::release::evaluate::Evaluation;
use guard4d_engine::release::gate::Shortfall;
use guard4d_engine::watermark::embed::{Embedding, Estimate, HeldOutEvaluation, PhaseReport, StopReason};
use serde::Serialize;

use super::args::{EmbedArgs, What};
use super::inputs::Inputs;
use super::settings::Settings;
use super::training::{Checkpoints, train};
use crate::flags::common::Common;
use crate::shared::farm_job::{FarmJob, keep_in_records, resumed};
use crate::ui::outcome::Outcome;
use crate::ui::report::{Row, cost_rows, evidence_in_words, percent, print, print_text, reading_rows, say, table};
use crate::ui::stop;

/// What `--json` prints.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    evaluation: &'a Evaluation,
    evidence: &'static str,
    missed: &'a [Shortfall],
    seconds: &'a BTreeMap<String, f64>,
    /// What clips that training never sees showed meanwhile.
    evaluations: &'a [HeldOutEvaluation],
    /// What each phase bought; empty with `--fit full`.
    phases: &'a [PhaseReport],
    /// Most device memory taken from the driver at one time.
    peak_memory_bytes: u64,
    /// Most of it that was in use at one time; the rest lay idle in blocks.
    peak_used_bytes: u64,
}

/// What is written beside the marked model at the shipped settings, about: extractor, what undoes the mark, preview.
const PRIVATE_BYTES: u64 = 10_000_000;

pub(crate) const FARM: FarmJob = FarmJob {
    command: "embed",
    has_input: true,
    needs_device: true,
    arguments: resumed,
    reserved: &["dry-run", "out", "overwrite", "resume", "show-config"],
    keep: keep_in_records,
    trial: Some(|estimate| {
        let seconds = |part: &str| estimate[part].as_f64().unwrap_or_default();
        Trial {
            seconds: seconds("plan_seconds") + seconds("fit_seconds") + seconds("train_seconds"),
            device_bytes: estimate["peak_memory_bytes"].as_u64().unwrap_or_default(),
            added_bytes: PRIVATE_BYTES,
        }
    }),
};

pub(crate) fn run(args: &EmbedArgs, common: &Common) -> Result<Outcome, EngineError> {
    let EmbedArgs { model, what, given, resources } = args;
    let settings = Settings::new(what.config.as_deref(), &given.0)?;
    if what.show_config {
        print_text(&settings.to_toml())?;
        return Ok(Outcome::Done);
    }
    let (Some(path), What { key: Some(key), out: Some(folder), .. }) = (model, what) else {
        return Err(EngineError::Usage {
            what: "embed".to_owned(),
            got: "no model, key or output".to_owned(),
            expected: "all three, or --show-config".to_owned(),
        });
    };
    if resources.dry_run {
        return dry_run(&Inputs::open(path, key, what, settings, common)?, common);
    }
    stop::listen(common);
    let out = AtomicDir::create(folder, what.overwrite.existing())?;
    let every = Duration::from_secs(settings.job.run.checkpoint_every_s);
    let inputs = Inputs::open(path, key, what, settings, common)?;
    let Inputs { gate, cameras, config, .. } = &inputs;
    let subject = inputs.subject();
    // Beside the output folder, so that an unfinished run leaves nothing in it.
    let checkpoint = checkpoint::path_beside(folder);
    if resources.resume {
        // What cannot be read is told before the views are planned.
        TensorFile::read(&checkpoint)?;
    }
    let mut embedding = Embedding::prepare(subject, config.clone())?;
    if resources.resume {
        embedding.restore(&checkpoint)?;
    }
    let embedded = train(embedding, common, Some(Checkpoints { path: &checkpoint, every }))?;
    let Inputs { payload, class_films, .. } = inputs;
    let delivery = Delivery { subject, config, embedded: &embedded, input: path, payload, class_films };
    let (evaluation, _) = delivery::write(out.path(), &delivery, cameras)?;
    out.commit()?;
    checkpoint::remove(&checkpoint);
    let missed = gate.missed(&evaluation);
    let evidence = evidence_in_words(evaluation.mode, evaluation.key_rotation.of > 1);
    let MemoryUse { peak_reserved_bytes: peak_memory_bytes, peak_bytes: peak_used_bytes, .. } =
        inputs.device.memory_use();
    let result = Printed {
        evaluation: &evaluation,
        evidence,
        missed: &missed,
        seconds: &embedded.seconds,
        evaluations: &embedded.evaluations,
        phases: &embedded.phases,
        peak_memory_bytes,
        peak_used_bytes,
    };
    print(common, &result, |result| {
        let costs = cost_rows(result.evaluation, result.seconds, result.peak_memory_bytes);
        table(&[reading_rows(result.evaluation), phase_rows(result.phases), costs].concat())
    })?;
    Ok(judge(&missed))
}

/// What each phase bought, for people.
fn phase_rows(phases: &[PhaseReport]) -> Vec<Row> {
    let row = |phase: &PhaseReport| {
        let PhaseReport { splats, offsets, clips, steps, stop_reason, evaluation } = phase;
        let why = match stop_reason {
            StopReason::Enough => "enough",
            StopReason::Flat => "no more progress",
            StopReason::Steps => "out of steps",
        };
        let bits = percent(evaluation.clip_accuracy.into());
        let (proven, psnr) = (percent(evaluation.proven.into()), evaluation.psnr.0);
        let what = format!("{offsets} offsets on {splats} splats, {clips} clips, {steps} steps: {why}");
        ("phase", format!("{what}; held out: bits right {bits}, clips that prove it alone {proven}, {psnr:.2} dB"))
    };
    phases.iter().map(row).collect()
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
    if missed.is_empty() { Outcome::Done } else { Outcome::GateMissed }
}
