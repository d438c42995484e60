//! What films are framed by: thumbnails of the training views.

use std::sync::Arc;

use super::config::{EmbedConfig, FramingChoice};
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::media::Frame;
use crate::picture::known_views::{KnownViews, MOST_VIEWS};
use crate::render::SceneRenderer;
use crate::scene::{Camera, FrameSize};

/// Longer side of the frames that thumbnails are made of, at most. Of 160 px, thin legs and soft edges are another
/// share of an asset, and films of 400 px were cut 6 % too small (fox).
const PROBE_PX: u32 = 400;
/// How much views show, as factors of training's in both directions: as much as training, or twice as much where the
/// asset fills its frames. From farther away it stands out all the same.
const SHOWN: [f64; 2] = [1.0, 2.0];
/// Share of the views in which the asset has to stand out for films to be framed.
const STANDS_OUT: f64 = 0.9;

/// Remembers what the views of `shots` look like, if that is asked for and the asset stands out. Without it films are
/// shown whole.
///
/// Training's own views stay as they are. Moved by 3 % of a side and grown by 5 % they would suit the errors of
/// framing; but a mark is made of what all views answer alike, and moved ones answer alike to little: 67 instead of
/// 93 % of 32 bits (robot, one key, 600 steps at 200 px).
pub(super) fn frame(
    renderer: &mut SceneRenderer,
    config: &EmbedConfig,
    shots: &[Vec<(Camera, f32)>],
) -> Result<Option<Arc<KnownViews>>, EngineError> {
    if config.views.framing == FramingChoice::Whole {
        return Ok(None);
    }
    let all: Vec<(Camera, f32)> = shots.iter().flatten().copied().collect();
    for times in SHOWN {
        let (views, stands_out) = look(renderer, config, &all, times)?;
        let suits = stands_out >= STANDS_OUT || config.views.framing == FramingChoice::Known;
        tracing::debug!(stands_out, times, "share of training views in which the asset stands out");
        if suits && !views.is_empty() {
            return Ok(Some(Arc::new(views)));
        }
    }
    Ok(None)
}

/// What views look like that show so many times as much, and in which share of them the asset stands out.
fn look(
    renderer: &mut SceneRenderer,
    config: &EmbedConfig,
    all: &[(Camera, f32)],
    times: f64,
) -> Result<(KnownViews, f64), EngineError> {
    let (width, height) = config.views.size_px;
    let part = |n: u32| (n * PROBE_PX).div_ceil(width.max(height)).min(n);
    let probe = FrameSize::new(part(width), part(height))?;
    let looks = all.len().min(MOST_VIEWS);
    // Evenly over all of them; in the order of time, so that what moves is moved once for each.
    let wide = |camera: Camera| {
        let camera = camera.resized(probe);
        Camera { fx: camera.fx / narrow(times), fy: camera.fy / narrow(times), ..camera }
    };
    let seen = (0..looks).map(|i| all[i * all.len() / looks]).map(|(camera, time)| (wide(camera), time));
    let mut seen: Vec<(Camera, f32)> = seen.collect();
    seen.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (mut views, mut stands_out) = (KnownViews::default(), 0.0);
    renderer.render_clips(&[seen], |_, camera, pixels| {
        let frame = Frame::from_rgba32f(camera.width, camera.height, pixels)?;
        stands_out += f64::from(u8::from(views.add(&frame, times)));
        Ok(())
    })?;
    Ok((views, stands_out / looks as f64))
}
