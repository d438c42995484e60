//! The second half of the story: three copies of the marked scene, one of which is filmed from above and traced.

use std::path::Path;

use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::detect::gathered::{KnownFilm, gather};
use guard4d_engine::detect::trace::{DEFAULT_FPR, Report, TraceRequest, judge};
use guard4d_engine::device::Device;
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::fidelity::{DEFAULT_PSNR_DB, strength_for};
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::media::FrameSource;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::release::delivery::{MARKED, PRIVATE};
use guard4d_engine::release::ledger::{Ledger, Terms};
use guard4d_engine::release::recipients::parse_list;
use guard4d_engine::release::stamping::{CopyFolder, stamp_all};
use guard4d_engine::render::render_frames;
use guard4d_engine::scene::camera::classes::CameraClass;
use guard4d_engine::scene::camera::paths::{Lens, USUAL_FOV_X_RAD};
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt, Model};

use crate::shared::media::{ffmpeg, read_options};
use crate::ui::stop;

/// Who gets a copy, and whose leaks.
const RECIPIENTS: [&str; 3] = ["ana", "bo", "cleo"];
const LEAKED: &str = "bo";
/// The film that leaks, and its cameras.
const FILM: &str = "leaked-copy.mp4";
const CAMERAS: &str = "leaked-copy.json";
/// Who got which copy.
const LEDGER: &str = "copies.ledger";
/// The folder of all copies.
const COPIES: &str = "copies";
/// Frames of the film.
const FRAMES: u32 = 16;

/// Stamps copies of the marked scene in `out`, films one of them, and traces the film.
pub(super) fn story(device: &Device, out: &Path, size_px: (u32, u32)) -> Result<Report, EngineError> {
    let model = Model::open(&out.join(MARKED))?;
    let ledger = &mut ledger(device, &model, &out.join(PRIVATE).join(LEDGER))?;
    let issue = Issue::new(&model, ledger.prf(), ledger.terms().strength);
    let records = ledger.reserve(&parse_list(RECIPIENTS)?)?;
    let copies = out.join(COPIES);
    let folder = CopyFolder { out: &copies, model: &out.join(MARKED), existing: Existing::Refuse };
    stamp_all(&issue, ledger, records, folder, &mut |_| stop::check())?;

    let cameras = from_above(&model, size_px)?;
    let leaked = render_frames(device, &Model::open(&folder.path_of(LEAKED))?, &cameras)?;
    let (film, path) = (out.join(FILM), out.join(CAMERAS));
    write_video(&film, &leaked.concat(), &EncodeOptions { ffmpeg: ffmpeg(), ..EncodeOptions::default() })?;
    AtomicFile::write(&path, Existing::Refuse, &cameras.film_json())?;

    let source = FrameSource::open(&film, &read_options())?;
    let known = KnownFilm::new(&film, &source, &cameras)?;
    let mut gathered = gather(device, &issue, &[known], &mut stop::check)?;
    let request = TraceRequest { device, issue: &issue, ledger, copies: 0, fpr: DEFAULT_FPR };
    judge(&request, &mut gathered)
}

/// The ledger of the demonstration's issue.
fn ledger(device: &Device, model: &Model, path: &Path) -> Result<Ledger, EngineError> {
    let mut terms = Terms {
        secret: MasterSecret::generate()?,
        original: model.digest(),
        splats: model.gaussians.len() as u64,
        strength: 1.0,
        psnr_db: DEFAULT_PSNR_DB,
        receipt: None,
    };
    terms.strength = strength_for(device, Issue::new(model, terms.prf(), terms.strength), DEFAULT_PSNR_DB)?;
    Ledger::create(path, &terms)
}

/// A film of cameras that nobody trained for.
fn from_above(model: &Model, size_px: (u32, u32)) -> Result<CameraSet, EngineError> {
    let lens = Lens { fov_x_rad: USUAL_FOV_X_RAD, size: FrameSize::new(size_px.0, size_px.1)? };
    let mut cameras = CameraClass::Above.cameras(LookAt::of(model, USUAL_FOV_X_RAD), lens, FRAMES)?;
    for (view, number) in cameras.views.iter_mut().zip(0u8..) {
        view.times = vec![f32::from(number) / FRAMES as f32];
    }
    Ok(CameraSet { in_sequence: true, ..cameras })
}
