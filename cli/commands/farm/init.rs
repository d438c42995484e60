//! `guard4d farm init`

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use guard4d_engine::base::output::AtomicFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::Model;

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::ui::outcome::Outcome;
use crate::ui::report::note;

/// Name of the manifest that is written.
const NAME: &str = "farm.csv";

/// Where models are looked for.
#[derive(Args, Debug)]
pub(super) struct InitArgs {
    /// Folder with models
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(super) fn run(args: &InitArgs, common: &Common) -> Result<Outcome, EngineError> {
    let path = args.folder.join(NAME);
    let out = AtomicFile::create(&path, args.overwrite.existing())?;
    let models = models(&args.folder)?;
    out.finish(manifest(&models).as_bytes())?;
    note(common, &format!("wrote {} with {} models; next: guard4d farm plan {0}", path.display(), models.len()));
    Ok(Outcome::Done)
}

/// A model, by its name in the folder.
struct Found {
    name: String,
    bytes: u64,
}

/// What in the folder opens as a model, by name.
fn models(folder: &Path) -> Result<Vec<Found>, EngineError> {
    let io = |source| EngineError::Io { path: folder.to_path_buf(), source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let Some(name) = path.file_name().and_then(|name| name.to_str()).filter(|name| !name.starts_with('.')) else {
            continue;
        };
        if let Ok(model) = Model::open(&path) {
            let bytes = model.sources().iter().map(|source| source.bytes().len() as u64).sum();
            found.push(Found { name: name.to_owned(), bytes });
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

/// The manifest, with words about its columns.
fn manifest(models: &[Found]) -> String {
    let mut text = "\
# A row for each job. Paths are relative to this file.
# id      a name that no other row has
# job     keygen, embed, verify, render, attack or convert
# input   what the job reads
# output  what it makes
# cost    how long it takes compared with other rows: here the bytes of the model. Longer rows are taken first.
# All other columns are flags of the job by their names, such as message, profile or config; a cell without a value
# gives none. Columns that are no flags go into the records as they are.
# Next: guard4d farm plan farm.csv; guard4d farm run farm.csv
id,job,input,output,cost,key,bits
key,keygen,,owner.key,0,,16
"
    .to_owned();
    for Found { name, bytes } in models {
        let id: String =
            name.chars().map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
        let quoted =
            if name.contains([',', '"', '\n']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.clone() };
        writeln!(text, "{id},embed,{quoted},marked/{id},{bytes},owner.key,").expect("a text takes text");
    }
    text
}
