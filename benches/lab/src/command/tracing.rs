//! `guard4d lab tracing`

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::fidelity::{DEFAULT_PSNR_DB, strength_for};
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::scene::{Model, Motion};
use guard4d_kernels::Device;

use super::host::Host;
use crate::study::SceneSource;
use crate::tracing::film::{FILMS, Film, spoil};
use crate::tracing::filmed::{Filmed, Size};
use crate::tracing::leak::{Leak, RULES, without_removed};
use crate::tracing::measure::{self as readings, Reading};
use crate::tracing::pages;
use crate::tracing::rewritten::{WAYS, Way};

/// Sizes of coalitions.
const COALITIONS: [usize; 4] = [2, 3, 5, 8];
/// Frames that coalitions are filmed for.
const LONG: u32 = 96;
/// Strengths of copies, as a PSNR, dB.
const STRENGTHS_DB: [f64; 5] = [43.0, 46.0, 49.0, 52.0, 55.0];
/// Lengths of films, frames.
const LENGTHS: [u32; 6] = [1, 3, 6, 12, 48, 96];

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Part {
    /// A copy in every film.
    Films,
    /// The original and a stranger's copy in every film, by several keys: nobody may be named.
    Innocent,
    /// Copies that were mixed.
    Collusion,
    /// Copies that somebody worked on, filmed and as assets; static ones also through `--splat-transform`.
    Models,
    /// A copy at several strengths.
    Stamping,
    /// A copy in films of several lengths.
    Frames,
}

/// What is stamped, and where readings go.
#[derive(Args, Debug)]
pub(super) struct TracingArgs {
    /// Models, or demo
    #[arg(required = true, value_name = "MODEL")]
    pub(super) models: Vec<SceneSource>,
    /// What is measured
    #[arg(long, value_enum, value_delimiter = ',', default_value = "films")]
    pub(super) part: Vec<Part>,
    /// Keys, numbered from 1
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub(super) keys: u8,
    /// Only films of which the name contains one of these
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    pub(super) films: Vec<String>,
    /// Frames of a film
    #[arg(long, default_value_t = 24)]
    pub(super) frames: u32,
    /// Side of frames, px
    #[arg(long, default_value_t = 400)]
    pub(super) side: u32,
    /// PSNR of copies, dB
    #[arg(long, value_name = "DB", default_value_t = DEFAULT_PSNR_DB)]
    pub(super) target_psnr: f64,
    /// Table of readings; it grows, and what it has is not measured again
    #[arg(long, value_name = "FILE")]
    pub(super) out: PathBuf,
    /// PlayCanvas' splat-transform, which static copies are rewritten by
    #[arg(long, value_name = "PROGRAM")]
    pub(super) splat_transform: Option<PathBuf>,
    /// Folder for a page of tables and charts of all that the table has
    #[arg(long, value_name = "FOLDER")]
    pub(super) page: Option<PathBuf>,
}

/// What is measured at once: what leaks as which films.
struct Round {
    name: String,
    leak: Leak,
    films: Vec<Film>,
    size: Size,
    asked_db: f64,
    as_asset: bool,
    way: Option<Way>,
}

pub(super) fn run(args: &TracingArgs, host: &dyn Host) -> Result<(), EngineError> {
    host.listen();
    let device = host.open()?;
    let table = measure(args, &device, host)?;
    if let Some(page) = &args.page {
        let command = std::env::args().collect::<Vec<_>>().join(" ");
        for page in pages::write(page, table.rows(), &command, vec![device.info().name.clone()])? {
            host.note(&page.display().to_string());
        }
    }
    let worst = table.rows().iter().filter(|row| row.contributed > 0).map(|row| row.t).fold(f64::INFINITY, f64::min);
    let rows = table.rows().len();
    host.print(
        &serde_json::json!({ "readings": rows, "least_t": worst }),
        &format!("{rows} readings, least T {worst:.1}"),
    )
}

/// Measures what the table does not have; all that it has then.
pub(super) fn measure(args: &TracingArgs, device: &Device, host: &dyn Host) -> Result<Ledger<Reading>, EngineError> {
    let mut table: Ledger<Reading> = Ledger::open(&args.out)?;
    for source in &args.models {
        let (model, asset) = (source.open_in_kind()?, source.to_string());
        for key in 1..=args.keys {
            let prf = Prf::new(&MasterSecret::from_bytes([key; 32]));
            let mut issue = Issue::new(&model, prf.clone(), 1.0);
            let mut asked_db = f64::NAN;
            for round in rounds(args) {
                if host.is_stopped() {
                    return Err(EngineError::Stopped);
                }
                let is_it = |row: &&Reading| {
                    let of_round = row.leak == round.name && row.asked_db == round.asked_db;
                    row.asset == asset && row.key == key && row.frames == round.size.frames && of_round
                };
                let known: Vec<String> = table.rows().iter().filter(is_it).map(|row| row.film.clone()).collect();
                if round.way.is_some() && !matches!(model.motion, Motion::Still) {
                    continue;
                }
                if round.films.iter().all(|film| known.iter().any(|name| name == film.name)) && !round.as_asset {
                    continue;
                }
                if asked_db != round.asked_db {
                    asked_db = round.asked_db;
                    let strength = strength_for(device, Issue::new(&model, prf.clone(), 1.0), asked_db)?;
                    issue = issue.with_strength(strength);
                }
                let program = args.splat_transform.as_deref();
                measure_round(device, &issue, &round, &known, program, &mut |reading| {
                    let frames = round.size.frames;
                    let row =
                        Reading { asset: asset.clone(), key, leak: round.name.clone(), frames, asked_db, ..reading };
                    host.note(&format!("{asset} {key} {} {}: T {:.1}", row.leak, row.film, row.t));
                    table.append(vec![row])
                })?;
            }
        }
    }
    Ok(table)
}

fn rounds(args: &TracingArgs) -> Vec<Round> {
    let size = Size { frames: args.frames, side_px: args.side };
    let is_wanted =
        |film: &Film| args.films.is_empty() || args.films.iter().any(|name| film.name.contains(name.as_str()));
    let all: Vec<Film> = FILMS.into_iter().filter(is_wanted).collect();
    let usual: Vec<Film> = FILMS.into_iter().filter(|film| film.name == "h264 23").collect();
    let asked_db = args.target_psnr;
    let whole = |name: &str, leak| {
        let (name, films) = (name.to_owned(), all.clone());
        Round { name, leak, films, size, asked_db, as_asset: false, way: None }
    };
    let mut rounds = Vec::new();
    for part in &args.part {
        match part {
            Part::Films => rounds.push(whole("copy", Leak::Copy)),
            Part::Innocent => rounds.extend([whole("original", Leak::Original), whole("foreign", Leak::Foreign)]),
            Part::Collusion => {
                for (name, rule) in RULES {
                    rounds.extend(COALITIONS.map(|k| Round {
                        name: format!("{name} {k}"),
                        leak: Leak::Mixed(rule, k),
                        films: usual.clone(),
                        size: Size { frames: LONG, ..size },
                        asked_db,
                        as_asset: true,
                        way: None,
                    }));
                }
            }
            Part::Models => {
                let edits = [
                    ("pruned 10 %", Leak::Pruned(0.1)),
                    ("pruned 30 %", Leak::Pruned(0.3)),
                    ("pruned 50 %", Leak::Pruned(0.5)),
                    ("noise 0.05", Leak::Noise(0.05)),
                    ("flat", Leak::Flat),
                    ("stamped again", Leak::StampedAgain),
                    ("as splat", Leak::EightBits),
                ];
                let of = |name: &str, leak| Round { films: usual.clone(), as_asset: true, ..whole(name, leak) };
                rounds.extend(edits.map(|(name, leak)| of(name, leak)));
                if args.splat_transform.is_some() {
                    let rewritten = |way: Way| {
                        let films = if way.stays_in_place() { usual.clone() } else { Vec::new() };
                        Round { films, way: Some(way), ..of(way.name, Leak::Copy) }
                    };
                    rounds.extend(WAYS.map(rewritten));
                }
            }
            Part::Stamping => {
                rounds.extend(STRENGTHS_DB.map(|asked_db| Round { asked_db, ..whole("copy", Leak::Copy) }));
            }
            Part::Frames => {
                let of =
                    |frames| Round { films: usual.clone(), size: Size { frames, ..size }, ..whole("copy", Leak::Copy) };
                rounds.extend(LENGTHS.map(of));
            }
        }
    }
    rounds
}

/// Hands over readings of all films of a round that are not known.
fn measure_round(
    device: &Device,
    issue: &Issue<'_>,
    round: &Round,
    known: &[String],
    program: Option<&Path>,
    each: &mut dyn FnMut(Reading) -> Result<(), EngineError>,
) -> Result<(), EngineError> {
    let folder = tempfile::tempdir().map_err(|source| EngineError::Io { path: std::env::temp_dir(), source })?;
    let copies = round.leak.copies();
    let is_new = |name: &str| !known.iter().any(|film| film == name);
    let mut gaussians = round.leak.gaussians(issue);
    if let Some((way, program)) = round.way.zip(program) {
        gaussians = way.through(program, &gaussians, folder.path())?;
    }
    let mut filmed: Vec<Filmed> = Vec::new();
    for film in round.films.iter().filter(|film| is_new(film.name)) {
        if !filmed.iter().any(|filmed| filmed.film.class == film.class) {
            filmed.push(Filmed::new(device, issue.model(), &gaussians, *film, round.size)?);
        }
        let of_class = filmed.iter().find(|filmed| filmed.film.class == film.class).expect("it was filmed");
        let spoilt = spoil(device, film, &of_class.frames, &of_class.shots, folder.path())?;
        let reading = match copies.is_empty() {
            true => readings::innocent_film(device, issue, &spoilt)?,
            false => readings::film(device, issue, &spoilt, &copies)?,
        };
        each(Reading { film: film.name.to_owned(), psnr_db: of_class.psnr_db, ..reading })?;
    }
    if round.as_asset && is_new("asset") {
        let leaked = Model::of_splats(Path::new("leak.ply"), &without_removed(&gaussians), issue.model().background)?;
        let reading = readings::asset(device, issue, &leaked, &copies)?;
        each(Reading { film: "asset".to_owned(), ..reading })?;
    }
    Ok(())
}
