//! `guard4d study`

use std::sync::Arc;

use guard4d_engine::EngineError;
use guard4d_engine::clip::ClipSource;
use guard4d_engine::lpips::LpipsWeights;
use guard4d_engine::study::{Scale, Step, Study, Substudy};
use guard4d_engine::watermark::general::GeneralExtractor;
use serde::Serialize;

use crate::args::{Common, StudyArgs, StudyPart};
use crate::report::{Outcome, note, print};
use crate::{devices, stop};

/// What `--json` prints.
#[derive(Serialize)]
struct Printed {
    pages: Vec<std::path::PathBuf>,
}

pub(crate) fn run(args: &StudyArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let open = || devices::open(common);
    let study = Study {
        scale: scale(args)?,
        clip: ClipSource::from_argument(&args.clip),
        open: &open,
        out: args.out.clone(),
        command: std::env::args().collect::<Vec<_>>().join(" "),
    };
    let mut what: Vec<Substudy> = args.what.iter().flat_map(|part| substudies(*part)).collect();
    what.dedup();
    let pages = study.run(&what, &mut |step| {
        if let Step::Embedding { cell, index, len } = step {
            let seed = cell.arm.config.seed;
            note(common, &format!("{}/{len} {}: {}, seed {seed}", index + 1, cell.scene, cell.arm.name));
        }
        stop::check()
    })?;
    print(common, &Printed { pages }, |printed| {
        printed.pages.iter().map(|page| page.display().to_string()).collect::<Vec<_>>().join("\n")
    })?;
    Ok(Outcome::Done)
}

fn scale(args: &StudyArgs) -> Result<Scale, EngineError> {
    let scale = if args.quick { Scale::quick() } else { Scale::full() };
    Ok(Scale {
        scenes: if args.scenes.is_empty() { scale.scenes } else { args.scenes.clone() },
        seeds: if args.seeds.is_empty() { scale.seeds } else { args.seeds.clone() },
        size_px: args.size.unwrap_or(scale.size_px),
        steps: args.effort.steps.map(|steps| steps as usize).or(scale.steps),
        clips: args.effort.train_clips.or(scale.clips),
        responses: args.effort.responses.map(|responses| responses as usize).or(scale.responses),
        mixings: args.effort.mixings.or(scale.mixings),
        general: general(args)?,
        lpips: args.lpips.as_deref().map(LpipsWeights::read).transpose()?.map(Arc::new),
        quick: scale.quick,
        only: args.only.clone(),
    })
}

/// The one that is named, or the built-in one with the built-in CLIP.
fn general(args: &StudyArgs) -> Result<Option<Arc<GeneralExtractor>>, EngineError> {
    let is_mini = matches!(ClipSource::from_argument(&args.clip), ClipSource::Mini);
    if args.general.is_none() && !is_mini {
        return Ok(None);
    }
    Ok(Some(Arc::new(GeneralExtractor::open(args.general.as_deref())?)))
}

fn substudies(part: StudyPart) -> Vec<Substudy> {
    let one = match part {
        StudyPart::Table1 => Substudy::Table1,
        StudyPart::Table2 => Substudy::Table2,
        StudyPart::Table3 => Substudy::Table3,
        StudyPart::Table4 => Substudy::Table4,
        StudyPart::Extractors => Substudy::Extractors,
        StudyPart::Attacks => Substudy::Attacks,
        StudyPart::Pareto => Substudy::Pareto,
        StudyPart::Stability => Substudy::Stability,
        StudyPart::Fit => Substudy::Fit,
        StudyPart::General => Substudy::General,
        StudyPart::All => return Substudy::ALL.to_vec(),
    };
    vec![one]
}
