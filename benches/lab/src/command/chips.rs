//! `guard4d lab chips`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::delivery::{EXTRACTOR, MARKED, PRIVATE, RECEIPT};
use guard4d_engine::release::receipt::Receipt;
use guard4d_engine::scene::Model;
use guard4d_engine::scene::camera::classes::CameraClass;
use guard4d_engine::watermark::extractor::reader::Reader;
use guard4d_engine::watermark::extractor::weights::ExtractorWeights;
use guard4d_engine::watermark::key::owner_key::Key;

use super::host::Host;
use crate::tracing::film::{Edit, FILMS, Film};
use crate::tracing::filmed::Size;
use crate::tracing::owner::{self, ChipsRow, Delivered, Reading};

/// What was embedded, and where readings go.
#[derive(Args, Debug)]
pub(super) struct ChipsArgs {
    /// The unmarked model
    #[arg(value_name = "MODEL")]
    original: PathBuf,
    /// What `embed` wrote
    #[arg(long, value_name = "FOLDER")]
    delivered: PathBuf,
    /// Owner key, made with the built-in CLIP
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Frames of a film
    #[arg(long, default_value_t = 24)]
    frames: u32,
    /// Side of frames, px
    #[arg(long, default_value_t = 400)]
    side: u32,
    /// Table of readings; it grows, and what it has is not measured again
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

pub(super) fn run(args: &ChipsArgs, host: &dyn Host) -> Result<(), EngineError> {
    host.listen();
    let device = host.open()?;
    let mut table: Ledger<ChipsRow> = Ledger::open(&args.out)?;
    let path = args.delivered.join(PRIVATE).join(RECEIPT);
    let receipt = Receipt::read(&path)?;
    let views = receipt.config(&path)?.views;
    let promise = receipt.body.promise;
    let clip = ClipModel::load(&device, &ClipSource::Mini)?;
    let key = promise.key_for(&Key::read(&args.key, &clip)?)?;
    let chips = promise.owner_chips.ok_or_else(|| EngineError::BadData {
        path,
        field: "owner_chips".to_owned(),
        got: "none".to_owned(),
        expected: "those of an asset that chips were written into".to_owned(),
    })?;
    // A file comes back as a file of its kind, in the folder.
    let folder = args.delivered.join(MARKED);
    let file = args.original.file_name().filter(|_| args.original.is_file()).map(|name| folder.join(name));
    let marked = file.filter(|file| file.is_file()).unwrap_or(folder);
    // As `embed` and `verify` open them: the chips are of the original as a copy of it is written.
    let (original, marked) = (Model::open(&args.original)?, Model::open(&marked)?);
    let issue = Issue::of_owner(&original, key.prf(), chips.strength);
    let asset = args.original.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let folder = tempfile::tempdir().map_err(|source| EngineError::Io { path: std::env::temp_dir(), source })?;
    let weights = ExtractorWeights::read(&args.delivered.join(PRIVATE).join(EXTRACTOR), &key)?;
    let mut reader = Reader::new(&device, &clip, &key, &weights)?;
    let mut reading = Reading { reader: &mut reader, views: &views, message: key.own_message() };
    let delivered = Delivered { issue: &issue, marked: &marked };
    for (film, frames) in films(args.frames) {
        if host.is_stopped() {
            return Err(EngineError::Stopped);
        }
        let is_known = |row: &ChipsRow| row.asset == asset && row.film == film.name && row.frames == frames;
        if table.newest(is_known).is_some() {
            continue;
        }
        let size = Size { frames, side_px: args.side };
        let row = owner::read(&device, &delivered, &mut reading, film, size, folder.path())?;
        let ChipsRow { t, alone, beside, bits, .. } = row;
        host.note(&format!("{asset} {} of {frames}: T {t:.1}, {alone} of {bits} alone, {beside} beside", film.name));
        table.append(vec![ChipsRow { asset: asset.clone(), ..row }])?;
    }
    let rows = table.rows().len();
    host.print(&serde_json::json!({ "readings": rows }), &format!("{rows} readings"))
}

/// Every codec, every class of cameras, and a film of one frame.
fn films(frames: u32) -> Vec<(Film, u32)> {
    let plain = FILMS.into_iter().filter(|film| film.edit == Edit::None);
    let usual = |film: &&Film| film.class == CameraClass::Usual && film.name == "h264 23";
    plain.map(|film| (film, frames)).chain(FILMS.iter().find(usual).map(|film| (*film, 1))).collect()
}
