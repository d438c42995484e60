//! `guard4d farm report`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::output::AtomicFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::ledger::{JobFigures, Ledger, Mark};
use guard4d_engine::farm::manifest::Manifest;
use guard4d_engine::farm::status::Status;
use serde::Serialize;

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::ui::document::farm::{FarmDocument, Picture};
use crate::ui::outcome::Outcome;
use crate::ui::report::{print, table};

/// What is told of which manifest.
#[derive(Args, Debug)]
pub(super) struct ReportArgs {
    /// Manifest: .csv or .jsonl
    manifest: PathBuf,
    /// Page to write: failures, figures, when who did what, and pictures, in one file that needs no other
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
    /// Also write how each row stands, for a spreadsheet
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Most pictures in the page, of the marks that are read worst
    #[arg(long, value_name = "N", default_value_t = 12, requires = "out")]
    pictures: usize,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Printed {
    ledger: PathBuf,
    status: Status,
    jobs: Vec<JobFigures>,
    marks: Vec<Mark>,
}

pub(super) fn run(args: &ReportArgs, common: &Common) -> Result<Outcome, EngineError> {
    let manifest = Manifest::open(&args.manifest)?;
    let create = |path: &PathBuf| AtomicFile::create(path, args.overwrite.existing());
    let (page, csv) = (args.out.as_ref().map(create).transpose()?, args.csv.as_ref().map(create).transpose()?);
    let ledger = Ledger::merge(&manifest)?;
    let (status, jobs, marks) = (Status::of(&manifest)?, ledger.jobs()?, ledger.marks(&manifest)?);
    if let Some(page) = page {
        let pictures = marks.iter().take(args.pictures).filter_map(|mark| Picture::of(manifest.folder(), mark));
        let name = args.manifest.file_name().unwrap_or_default().to_string_lossy();
        let document = FarmDocument {
            name: &name,
            status: &status,
            jobs: &jobs,
            marks: &marks,
            spans: &ledger.spans()?,
            pictures: pictures.collect(),
        };
        page.finish(document.html().as_bytes())?;
    }
    if let Some(file) = csv {
        file.finish(&ledger.csv()?)?;
    }
    let has_failed = status.failed > 0;
    print(common, &Printed { ledger: ledger.path().to_path_buf(), status, jobs, marks }, human)?;
    Ok(if has_failed { Outcome::RowsFailed } else { Outcome::Done })
}

fn human(printed: &Printed) -> String {
    let Printed { ledger, status, jobs, marks } = printed;
    let mut rows = vec![
        ("ledger", ledger.display().to_string()),
        ("rows", status.rows.to_string()),
        ("done", status.done.to_string()),
        ("failed", status.failed.to_string()),
    ];
    for JobFigures { job, done, median_s, most_s, .. } in jobs {
        rows.push(("job", format!("{job}: {done} done, {median_s:.2} s at the median, {most_s:.2} s at most")));
    }
    if let Some(worst) = marks.first() {
        rows.push(("worst mark", format!("{}: {:.1} % of bits", worst.id, 100.0 * worst.bit_accuracy)));
    }
    table(&rows)
}
