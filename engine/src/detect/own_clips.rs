//! Films without a mark that the program brings along: procedural scenes, the same in every verification.
//!
//! They have nothing to do with anybody's asset. A reader that recites its owner's message whatever it is shown says it
//! of them, too.

use guard4d_kernels::Device;

use crate::base::prf::{MasterSecret, Prf, Purpose};
use crate::error::EngineError;
use crate::media::Frame;
use crate::render::render_frames;
use crate::scene::camera::paths::{Lens, Orbit};
use crate::scene::{FrameSize, LookAt, procedural};

/// How many; as many as a verification of a short film can spare the time for.
pub const OWN_CLIPS: u64 = 6;
/// Frames of each: one look of the extractor.
const FRAMES: u32 = 8;
const SIDE_PX: u32 = 160;
/// Where everybody's clips come from; nothing secret.
const SECRET: [u8; 32] = *b"guard4d: clips without a mark, 1";

/// The clips, each of one scene that a camera goes around.
///
/// # Errors
/// When the device fails.
pub fn own_clips(device: &Device) -> Result<Vec<Vec<Frame>>, EngineError> {
    let prf = Prf::new(&MasterSecret::from_bytes(SECRET));
    let lens = Lens { fov_x_rad: 0.7, size: FrameSize::new(SIDE_PX, SIDE_PX)? };
    let clip = |number: u64| {
        let scene = procedural::scene(&mut prf.stream(Purpose::Scenes, number))?;
        // From another height each.
        let elevation_deg = 10.0 + 8.0 * number as f64;
        let orbit = Orbit { views: FRAMES, elevation_deg, look_at: LookAt::D_NERF, lens };
        Ok(render_frames(device, &scene, &orbit.cameras()?.at_times(&[0.0]))?.concat())
    };
    (0..OWN_CLIPS).map(clip).collect()
}
