//! Hash of all that a picture of a scene depends on, as it is in memory.

use super::deformation::{DeformationWeights, Head, Linear, Plane};
use super::gaussians::Gaussians;
use super::model::Model;
use super::motion::Motion;
use super::trajectories::Trajectories;
use super::warp::{PositionHead, WarpWeights};
use crate::base::digest::Digest;

impl Model {
    /// Hash of splats, motion and background. Two models with the same one look the same at every moment, whatever
    /// files they came from; [`Model::digest`] knows nothing of motion that has a file of its own.
    #[must_use]
    pub fn content(&self) -> Digest {
        let mut content = Content(blake3::Hasher::new());
        content.gaussians(&self.gaussians);
        content.motion(&self.motion);
        content.floats(&self.background);
        Digest::from_bytes(*content.0.finalize().as_bytes())
    }
}

/// A hash under way. Every part says its length first and every choice its name, so that no two scenes run together.
/// Types are taken apart whole: a field that is added has to be hashed, or left out on purpose.
struct Content(blake3::Hasher);

impl Content {
    fn floats(&mut self, values: &[f32]) {
        self.number(values.len());
        self.0.update(bytemuck::cast_slice(values));
    }

    fn number(&mut self, value: usize) {
        self.0.update(&(value as u64).to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.number(text.len());
        self.0.update(text.as_bytes());
    }

    fn gaussians(&mut self, gaussians: &Gaussians) {
        let Gaussians { means, quats, scales, opacities, sh_coeffs, sh_degree } = gaussians;
        let parts = [means.as_flattened(), quats.as_flattened(), scales.as_flattened(), opacities, sh_coeffs];
        parts.into_iter().for_each(|part| self.floats(part));
        self.text(&sh_degree.to_string());
    }

    fn motion(&mut self, motion: &Motion) {
        match motion {
            Motion::Still => self.text("still"),
            Motion::HexPlane(weights) => self.hexplane(weights),
            Motion::Warp(weights) => self.warp(weights),
            Motion::Paths(paths) => self.paths(paths),
            Motion::Sequence(moments) => {
                self.text("sequence");
                self.number(moments.len());
                moments.iter().for_each(|moment| self.gaussians(moment));
            }
        }
    }

    fn hexplane(&mut self, weights: &DeformationWeights) {
        let DeformationWeights {
            config,
            aabb,
            grids,
            feature_out,
            pos_deform,
            scales_deform,
            rotations_deform,
            opacity_deform,
            shs_deform,
        } = weights;
        self.text("hexplane");
        // Hyperparameters are a handful, and their names and values are all that this form of them shows.
        self.text(&format!("{config:?}"));
        self.floats(aabb.as_flattened());
        self.number(grids.len());
        for Plane { data, channels, height, width } in grids.as_flattened() {
            [channels, height, width].into_iter().for_each(|size| self.number(*size));
            self.floats(data);
        }
        self.linears(feature_out);
        for Head { hidden, out } in [pos_deform, scales_deform, rotations_deform, opacity_deform, shs_deform] {
            self.linear(hidden);
            self.linear(out);
        }
    }

    fn warp(&mut self, weights: &WarpWeights) {
        let WarpWeights { time_net, layers, position, rotation, scaling } = weights;
        self.text("warp");
        self.linears(time_net.as_ref().map_or(&[], <[Linear; 2]>::as_slice));
        self.linears(layers);
        match position {
            PositionHead::Offset(offset) => {
                self.text("offset");
                self.linear(offset);
            }
            PositionHead::Screw { w, v } => {
                self.text("screw");
                self.linear(w);
                self.linear(v);
            }
        }
        self.linear(rotation);
        self.linear(scaling);
    }

    fn paths(&mut self, paths: &Trajectories) {
        let Trajectories { centres, log_durations, motion, omega } = paths;
        self.text("paths");
        let parts = [centres, log_durations, motion.as_flattened(), omega.as_flattened()];
        parts.into_iter().for_each(|part| self.floats(part));
    }

    fn linears(&mut self, layers: &[Linear]) {
        self.number(layers.len());
        layers.iter().for_each(|layer| self.linear(layer));
    }

    fn linear(&mut self, layer: &Linear) {
        let Linear { weight, bias, inputs, outputs } = layer;
        self.number(*inputs);
        self.number(*outputs);
        self.floats(weight);
        self.floats(bias);
    }
}
