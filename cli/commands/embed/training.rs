//! Training with a bar and checkpoints.

use std::path::Path;
use std::time::{Duration, Instant};

use guard4d_engine::error::EngineError;
use guard4d_engine::watermark::embed::{Embedded, Embedding, HeldOutReport, StepReport};

use crate::flags::common::Common;
use crate::ui::progress::bar;
use crate::ui::stop;

/// Where checkpoints go, and how often.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Checkpoints<'a> {
    pub(crate) path: &'a Path,
    pub(crate) every: Duration,
}

/// Steps until done or stopped; with a checkpoint file, a stop leaves a valid one, and so does the end.
pub(crate) fn train(
    mut embedding: Embedding<'_>,
    common: &Common,
    checkpoints: Option<Checkpoints<'_>>,
) -> Result<Embedded, EngineError> {
    let progress = bar(common, embedding.progress().1 as u64);
    let mut saved = Instant::now();
    let mut held_out = None;
    loop {
        if stop::is_requested() {
            progress.abandon();
            let Some(Checkpoints { path, .. }) = checkpoints else { return Err(EngineError::Stopped) };
            embedding.save(path)?;
            return Err(EngineError::Interrupted { checkpoint: path.to_owned() });
        }
        let Some(report) = embedding.step()? else { break };
        progress.set_position(embedding.progress().0 as u64);
        held_out = report.held_out.or(held_out);
        progress.set_message(state(&report, held_out));
        if let Some(Checkpoints { path, every }) = checkpoints
            && saved.elapsed() >= every
        {
            embedding.save(path)?;
            saved = Instant::now();
        }
    }
    // Measuring the result takes a while, too; whoever stops that need not train again.
    if let Some(Checkpoints { path, .. }) = checkpoints {
        embedding.save(path)?;
    }
    progress.finish_and_clear();
    embedding.finish()
}

/// What the bar says: the newest loss, and the newest figures on clips that are not trained on.
fn state(report: &StepReport, held_out: Option<HeldOutReport>) -> String {
    let loss = report.message;
    if let Some(number) = report.key_rotation {
        return format!("trying rotation {}  loss {loss:.3}", number + 1);
    }
    let figures = held_out.map(|h| format!("  held out: bits {:.0} %, {:.1} dB", 100.0 * h.bit_accuracy, h.psnr));
    format!("loss {loss:.3}{}", figures.unwrap_or_default())
}
