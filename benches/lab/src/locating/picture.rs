//! A leak that was located, to look at: a frame of the film, the original from where it was taken, what differs, and
//! what the whole film says of each splat.

use guard4d_engine::base::numbers::narrow;
use guard4d_engine::detect::exhibit::{Beside, Exhibit};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::seen::Seen;
use guard4d_engine::media::Frame;
use guard4d_engine::scene::gaussians::{CHANNELS, SH_FLOATS, Y0};
use guard4d_engine::scene::{Gaussians, Model};
use guard4d_kernels::Device;

use crate::tracing::film::Spoilt;
use crate::tracing::filmed::draw;
use crate::tracing::measure::expose;

/// Grey, where nothing is known of a splat; and how much more is shown of what is.
const GREY: f32 = 0.5;
const SHOWN: f64 = 15.0;
/// Pixels that a splat is seen in, from which on something is known of it.
const SEEN: f64 = 0.5;

/// Film, original, what differs four times as much, and evidence fifteen times as much, side by side; the frame is the
/// middle one. None for a film without frames.
///
/// # Errors
/// When the device fails.
pub fn sheet(device: &Device, model: &Model, located: &Spoilt) -> Result<Option<Frame>, EngineError> {
    let middle = located.frames.len() / 2;
    let Some(film) = located.frames.get(middle) else { return Ok(None) };
    let shot = &located.shots[middle..=middle];
    let original = draw(device, model, &model.gaussians, model.background, shot)?.remove(0);
    let evidence = draw(device, model, &evidence(device, model, located)?, [GREY; CHANNELS], shot)?.remove(0);
    let film = Exhibit { clip: String::new(), frame: middle as u64, picture: film.clone() };
    let compared = Beside::sheet(&[Beside { film, original }])?;
    Ok(Some(beside(&compared, &evidence)?))
}

/// The asset with grey colours, lighter where a film is lighter than the original, and darker where it is darker.
fn evidence(device: &Device, model: &Model, located: &Spoilt) -> Result<Gaussians, EngineError> {
    let exposures = expose(device, model, located)?;
    let found = exposures.evidence();
    let mut gaussians = model.gaussians.clone();
    gaussians.sh_coeffs.fill(0.0);
    let splats = gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS).zip(&found.residual).zip(&found.response);
    for ((coefficients, residual), response) in splats {
        if *response > SEEN {
            let level = (SHOWN * residual / response).clamp(-f64::from(GREY), f64::from(GREY));
            coefficients[..CHANNELS].fill(narrow(level / Y0));
        }
    }
    Ok(gaussians)
}

/// Two pictures of one height.
fn beside(left: &Frame, right: &Frame) -> Result<Frame, EngineError> {
    let lines = |frame: &Frame| 3 * frame.width() as usize;
    let rows = left.rgb().chunks_exact(lines(left)).zip(right.rgb().chunks_exact(lines(right)));
    let rgb = rows.flat_map(|(left, right)| left.iter().chain(right).copied()).collect();
    Frame::new(left.width() + right.width(), left.height(), rgb)
}
