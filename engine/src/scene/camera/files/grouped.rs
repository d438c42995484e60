//! Frames of one camera as one view.

use std::collections::HashMap;

use crate::scene::camera::cameras::{Camera, View};

/// Views in order of their first frame; frames of one camera become one view.
#[derive(Default)]
pub(super) struct Grouped {
    pub(super) views: Vec<View>,
    /// By all bits of the camera.
    index_from_camera: HashMap<[u32; 22], usize>,
}

impl Grouped {
    pub(super) fn add(&mut self, name: String, camera: Camera, time: Option<f32>) {
        let mut key = [0; 22];
        key[..16].copy_from_slice(&camera.world_to_camera.to_cols_array().map(f32::to_bits));
        key[16..20].copy_from_slice(&[camera.fx, camera.fy, camera.cx, camera.cy].map(f32::to_bits));
        key[20..].copy_from_slice(&[camera.width, camera.height]);
        let index = *self.index_from_camera.entry(key).or_insert(self.views.len());
        if index == self.views.len() {
            self.views.push(View { name, camera, times: Vec::new(), located: true });
        }
        self.views[index].times.extend(time);
    }
}
