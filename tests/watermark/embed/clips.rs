//! Where the cameras of clips stand.

use std::path::Path;

use glam::{DMat4, DVec3};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::scene::camera::look_at::LookAt;
use guard4d_engine::scene::{Camera, Model};
use guard4d_engine::watermark::embed::Embedding;

use crate::support::fixture;
use crate::support::gpu::device;
use crate::support::owner::{BITS, Owner};

/// Where the scene of this test stands.
const AWAY: [f32; 3] = [7.0, -3.0, 2.0];
/// Rounding of cameras in f32 at coordinates of up to 10: a few steps of 1e-6.
const ROUNDING: f64 = 1e-5;

/// Where a camera stands, and which way it looks.
fn stand(camera: &Camera) -> (DVec3, DVec3) {
    let to_world = DMat4::from_cols_array(&camera.world_to_camera.to_cols_array().map(f64::from)).inverse();
    (to_world.w_axis.truncate(), to_world.z_axis.truncate().normalize())
}

#[test]
fn a_film_turns_about_what_its_camera_looks_at() {
    let Some(gpu) = device() else { return };
    let mut owner = Owner::new(&gpu);
    let mut splats = fixture::gaussians(60, 1, 9);
    splats.means.iter_mut().for_each(|mean| *mean = std::array::from_fn(|axis| mean[axis] + AWAY[axis]));
    owner.model = Model::of_splats(Path::new("away.ply"), &splats, [1.0; 3]).expect("a scene");
    let config = owner.config_of(ExtractorMode::Joint).with_probes(BITS as usize).with(|c| {
        c.views.size_px = (32, 32);
        c.optimiser.held_out_every = 1;
    });
    let LookAt { target, radius, .. } = config.views.look_at(&owner.model);
    assert!(target.distance(DVec3::from_array(AWAY.map(f64::from))) < 1.0, "the scene is looked at: {target}");
    let embedding = Embedding::prepare(owner.subject(&gpu), config).expect("prepares");
    let clips: Vec<_> = embedding.training_shots().chain(embedding.held_out_shots()).collect();
    assert!(embedding.training_shots().count() == 2 && clips.len() > 2, "both kinds: {}", clips.len());
    for clip in clips {
        let stands: Vec<_> = clip.iter().map(|(camera, _)| stand(camera)).collect();
        let first = stands[0].0;
        for (frame, (position, forward)) in stands.iter().enumerate() {
            let (away, height) = (position.distance(target), position.z);
            assert!((away - radius).abs() < ROUNDING, "frame {frame}: {away} from the target, which wants {radius}");
            assert!((height - first.z).abs() < ROUNDING, "frame {frame}: height {height}, at first {}", first.z);
            // The sine of the angle, which is as small as the rounding when the target is in the middle.
            let beside = forward.cross((target - position).normalize()).length();
            assert!(beside < ROUNDING && forward.dot(target - position) > 0.0, "frame {frame}: {beside} beside it");
        }
        let moved = stands[1].0.distance(first);
        assert!(moved > 1e-3 * radius, "the camera turns, by {moved} a frame");
    }
}
