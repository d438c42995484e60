//! `guard4d lab locating`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::Model;

use super::host::Host;
use crate::locating::film::shots;
use crate::locating::measure::{self, LocatedRow};

/// What is filmed, and where readings go.
#[derive(Args, Debug)]
pub(super) struct LocatingArgs {
    /// Models
    #[arg(required = true, value_name = "MODEL")]
    models: Vec<PathBuf>,
    /// Films of each, drawn at random
    #[arg(long, value_name = "N", default_value_t = 30)]
    films: u64,
    /// Look for another asset in them, which must not be found
    #[arg(long, value_name = "MODEL")]
    other: Option<PathBuf>,
    /// Frames of a film
    #[arg(long, default_value_t = 48)]
    frames: u32,
    /// Table of readings; it grows, and what it has is not measured again
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

pub(super) fn run(args: &LocatingArgs, host: &dyn Host) -> Result<(), EngineError> {
    host.listen();
    let device = host.open()?;
    let mut table: Ledger<LocatedRow> = Ledger::open(&args.out)?;
    let folder = tempfile::tempdir().map_err(|source| EngineError::Io { path: std::env::temp_dir(), source })?;
    let other = args.other.as_deref().map(Model::open_in_kind).transpose()?;
    for path in &args.models {
        let model = Model::open_in_kind(path)?;
        let asset = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        for number in 0..args.films {
            if host.is_stopped() {
                return Err(EngineError::Stopped);
            }
            if table.newest(|row| row.asset == asset && row.film == number).is_some() {
                continue;
            }
            let shots = shots(&model, number, args.frames)?;
            let row = measure::film(&device, &model, other.as_ref().unwrap_or(&model), &shots, folder.path())?;
            let row = LocatedRow { asset: asset.clone(), film: number, ..row };
            host.note(&format!(
                "{asset} {number}: found {}, {:.2} px, {:.4} of the motion, {:.0} % near, likeness {:.2}, {:.0} s",
                row.found,
                row.error_px,
                row.error_time,
                100.0 * row.near,
                row.likeness,
                row.seconds
            ));
            table.append(vec![row])?;
        }
    }
    let (found, all) = (table.rows().iter().filter(|row| row.found).count(), table.rows().len());
    host.print(&serde_json::json!({ "found": found, "films": all }), &format!("{found} of {all} films found"))
}
