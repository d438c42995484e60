//! What a checkpoint belongs to.

use std::path::Path;

use guard4d_engine::base::tensor_file::Tensor;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::ClipModel;
use guard4d_engine::scene::trajectories::Trajectories;
use guard4d_engine::scene::{Model, Motion};
use guard4d_engine::watermark::embed::{Embedding, Subject};
use guard4d_engine::watermark::key::owner_key::Key;

use crate::support::gpu::{Gpu, device};
use crate::support::owner::{BITS, Owner, key_file};
use crate::support::{fixture, tiny_clip};

/// What is done to a model.
type Change = fn(&mut Model);

const SPLATS: usize = 60;

fn scene(motion: Motion) -> Model {
    let splats = fixture::gaussians(SPLATS, 1, 9);
    let mut model = Model::of_splats(Path::new("scene.ply"), &splats, [1.0; 3]).expect("a scene");
    model.motion = motion;
    model
}

/// Splats that stand still, but are said to move.
fn paths(speed: f32) -> Motion {
    Motion::Paths(Trajectories {
        centres: vec![0.5; SPLATS],
        log_durations: vec![3.0; SPLATS],
        motion: vec![[speed; 9]; SPLATS],
        omega: vec![[0.0; 4]; SPLATS],
    })
}

struct Trial<'a> {
    gpu: &'a Gpu,
    owner: &'a Owner,
    key: &'a Key,
}

impl Trial<'_> {
    fn prepare<'b>(&'b self, model: &'b Model, clip: &'b ClipModel) -> Embedding<'b> {
        let config = self.owner.config.clone().with_probes(BITS as usize).with(|c| c.views.size_px = (32, 32));
        let subject = Subject { device: self.gpu, clip, key: self.key, model, message: &self.owner.message };
        Embedding::prepare(subject, config).expect("prepares")
    }

    #[track_caller]
    fn assert_refused(&self, model: &Model, clip: &ClipModel, at: &Path, what: &str) {
        let refused = self.prepare(model, clip).restore(at).expect_err(what);
        assert!(matches!(&refused, EngineError::BadData { field, .. } if field == "identity"), "{what}: {refused}");
    }
}

#[test]
fn a_checkpoint_belongs_to_one_scene_one_motion_and_one_clip() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let weights = tiny_clip::weights();
    let clip = tiny_clip::load(&gpu, &weights);
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let key_path = folder.path().join("owner.key");
    std::fs::write(&key_path, key_file(&clip).to_bytes().expect("serialises")).expect("writable");
    let key = Key::read(&key_path, &clip).expect("the key fits the checkpoint");
    let trial = Trial { gpu: &gpu, owner: &owner, key: &key };
    let at = folder.path().join("checkpoint.safetensors");
    let model = scene(paths(0.0));
    trial.prepare(&model, &clip).save(&at).expect("saves");
    trial.prepare(&model, &clip).restore(&at).expect("the same embedding");

    let changes: [(&str, Change); 8] = [
        ("means", |m| m.gaussians.means[7][1] += 0.01),
        ("rotations", |m| m.gaussians.quats[7][1] += 0.01),
        ("scales", |m| m.gaussians.scales[7][1] += 0.01),
        ("opacities", |m| m.gaussians.opacities[7] += 0.01),
        ("colours", |m| m.gaussians.sh_coeffs[7] += 0.01),
        ("background", |m| m.background[1] = 0.0),
        ("motion", |m| m.motion = paths(0.01)),
        ("no motion", |m| m.motion = Motion::Still),
    ];
    for (what, change) in changes {
        let mut other = model.clone();
        change(&mut other);
        trial.assert_refused(&other, &clip, &at, what);
    }
    let mut other = weights;
    let bias = other.tensors.keys().find(|name| name.contains("vision") && name.ends_with("fc1.bias"));
    let bias = bias.expect("a bias of the image tower").clone();
    let shape = other.get(&bias).expect("it is there").shape.clone();
    let mut values = other.floats(&bias, &shape).expect("floats").to_vec();
    values[0] += 0.01;
    other.tensors.insert(bias, Tensor::f32(&shape, values));
    trial.assert_refused(&model, &tiny_clip::load(&gpu, &other), &at, "another CLIP");
}
