//! `guard4d lab locating`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::fidelity::{DEFAULT_PSNR_DB, strength_for};
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::locate::film::Locator;
use guard4d_engine::locate::views::Vantage;
use guard4d_kernels::Device;

use super::host::Host;
use crate::locating::attack::Attack;
use crate::locating::film::{USUAL_FRAMES, shots};
use crate::locating::measure::{self, Case, LocatedRow};
use crate::study::SceneSource;
use crate::tracing::leak::Leak;

/// What is filmed, and where readings go.
#[derive(Args, Debug)]
pub(super) struct LocatingArgs {
    /// Models, or demo
    #[arg(required = true, value_name = "MODEL")]
    pub(super) models: Vec<SceneSource>,
    /// Films of each, drawn at random
    #[arg(long, value_name = "N", default_value_t = 30)]
    pub(super) films: u64,
    /// Number of the first
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(super) first: u64,
    /// What is done to them
    #[arg(long, value_enum, value_delimiter = ',', default_value = "none")]
    pub(super) attack: Vec<Attack>,
    /// Look for another asset in them, which must not be found
    #[arg(long, value_name = "MODEL")]
    pub(super) other: Option<SceneSource>,
    /// Frames of a film; fewer are its beginning
    #[arg(long, default_value_t = USUAL_FRAMES)]
    pub(super) frames: u32,
    /// Table of readings; it grows, and what it has is not measured again
    #[arg(long, value_name = "FILE")]
    pub(super) out: PathBuf,
    /// Folder for a picture of each film that is found: the film, the original from there, what differs, and what the
    /// film says of each splat
    #[arg(long, value_name = "FOLDER")]
    pub(super) pictures: Option<PathBuf>,
}

pub(super) fn run(args: &LocatingArgs, host: &dyn Host) -> Result<(), EngineError> {
    host.listen();
    let device = host.open()?;
    let table = measure(args, &device, host)?;
    let (found, all) = (table.rows().iter().filter(|row| row.found).count(), table.rows().len());
    host.print(&serde_json::json!({ "found": found, "films": all }), &format!("{found} of {all} films found"))
}

/// Measures what the table does not have; all that it has then.
pub(super) fn measure(
    args: &LocatingArgs,
    device: &Device,
    host: &dyn Host,
) -> Result<Ledger<LocatedRow>, EngineError> {
    let mut table: Ledger<LocatedRow> = Ledger::open(&args.out)?;
    let folder = tempfile::tempdir().map_err(|source| EngineError::Io { path: std::env::temp_dir(), source })?;
    let other = args.other.as_ref().map(SceneSource::open_in_kind).transpose()?;
    for source in &args.models {
        let (model, asset) = (source.open_in_kind()?, source.to_string());
        let prf = Prf::new(&MasterSecret::from_bytes([1; 32]));
        let mut issue = Issue::new(&model, prf.clone(), 1.0);
        let strength = strength_for(device, Issue::new(&model, prf, 1.0), DEFAULT_PSNR_DB)?;
        issue = issue.with_strength(strength);
        let leaked = Leak::Copy.gaussians(&issue);
        let sought = other.as_ref().unwrap_or(&model);
        let mut locator = Locator::new(device, sought, Vantage::Around)?;
        for (number, attack) in (0..args.films).flat_map(|film| args.attack.iter().map(move |attack| (film, *attack))) {
            if host.is_stopped() {
                return Err(EngineError::Stopped);
            }
            let of = attack.name();
            let number = args.first + number;
            if table.newest(|row| row.asset == asset && row.film == number && row.attack == of).is_some() {
                continue;
            }
            let shots = shots(&model, number, args.frames)?;
            let pictures = args.pictures.as_deref();
            let case = Case { device, issue: &issue, leaked: &leaked, sought, attack, pictures };
            let named = LocatedRow { asset: asset.clone(), film: number, attack: of, ..LocatedRow::default() };
            let row = measure::film(&case, &mut locator, &shots, folder.path(), named)?;
            host.note(&told(&row));
            table.append(vec![row])?;
        }
    }
    Ok(table)
}

fn told(row: &LocatedRow) -> String {
    let LocatedRow { asset, film, attack, found, likeness, t, t_true, seconds, .. } = row;
    let of = |figure: Option<f64>, digits: usize, unit: &str| {
        figure.map_or(String::new(), |figure| format!(", {figure:.digits$} {unit}"))
    };
    format!(
        "{asset} {film} {attack}: found {found}{}{}{}, likeness {likeness:.2}, T {t:.1} of {t_true:.1}, {seconds:.0} s",
        of(row.error_px, 2, "px"),
        of(row.error_time, 4, "of the motion"),
        of(row.near.map(|near| 100.0 * near), 0, "% near"),
    )
}
