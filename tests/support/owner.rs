//! An owner with a key, a scene and a small embedding, for tests of the whole way.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::delivery::{self, Delivery};
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, FrameSize, LookAt, Model};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, Profile, Subject};
use guard4d_engine::watermark::key::owner_key::Key;
use guard4d_kernels::Device;
use nalgebra::DMatrix;

use super::gpu::Gpu;

/// Message bits of the key.
pub(crate) const BITS: u32 = 8;
/// Side of the training frames in pixels.
const SIDE_PX: u32 = 64;
const SECRET: [u8; 32] = [7; 32];
/// Logit of a written bit of [`key_of`].
const LOGIT_PER_CODE: f32 = 6.0;

/// Everything an embedding needs, made in a moment: the key's decoder is computed instead of trained.
pub(crate) struct Owner {
    pub(crate) clip: ClipModel,
    /// Of all assets.
    pub(crate) owner_key: Key,
    /// Of the model.
    pub(crate) key: Key,
    pub(crate) scene: DemoScene,
    pub(crate) model: Model,
    pub(crate) message: Message,
    pub(crate) config: EmbedConfig,
}

impl Owner {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self::with_bits(gpu, BITS)
    }

    /// With a key of `bits` bits.
    pub(crate) fn with_bits(gpu: &Gpu, bits: u32) -> Self {
        let clip = ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
        let owner_key = key_of(&clip, SECRET, bits);
        let scene = DemoScene::unpack().expect("the scene unpacks");
        let model = Model::open(scene.path()).expect("the scene opens");
        let key = owner_key.for_asset(model.digest()).expect("an owner's key");
        let message = key.own_message();
        let config = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind).with(|c| {
            c.optimiser.steps = 4;
            c.views.clips = 2;
            c.views.size_px = (SIDE_PX, SIDE_PX);
            c.extractor.calibration_mut().expect("fitted").probes = 2 * key.bits();
            c.seed = 5;
            c.optimiser.held_out_every = 0;
        });
        Self { clip, owner_key, key, scene, model, message, config }
    }

    /// The same settings with an extractor of this mode: of as many probes and the same copies, and trained from the
    /// first step on.
    pub(crate) fn config_of(&self, mode: ExtractorMode) -> EmbedConfig {
        self.config.clone().with(|config| {
            let calibration = config.extractor.calibration().cloned();
            config.extractor = EmbedConfig::new(config.profile, mode).extractor;
            if let (Some(own), Some(usual)) = (config.extractor.calibration_mut(), calibration) {
                *own = usual;
            }
            if let Some(joint) = config.extractor.joint_mut() {
                joint.tmsd_held = 0.0;
            }
            config.open_weights().expect("what is built in is whole");
        })
    }

    pub(crate) fn subject<'a>(&'a self, device: &'a Device) -> Subject<'a> {
        Subject { device, clip: &self.clip, key: &self.key, model: &self.model, message: &self.message }
    }

    pub(crate) fn prepare<'a>(&'a self, device: &'a Device) -> Embedding<'a> {
        Embedding::prepare(self.subject(device), self.config.clone()).expect("prepares")
    }

    /// Writes the delivery of an embedding into the new folder `out`.
    pub(crate) fn deliver(&self, device: &Device, embedded: &Embedded, out: &Path) {
        std::fs::create_dir_all(out).expect("writable");
        let subject = self.subject(device);
        let (config, input) = (&self.config, self.scene.path());
        let delivery = Delivery { subject, config, embedded, input, payload: None, class_films: 0 };
        delivery::write(out, &delivery, &cameras()).expect("delivers");
    }
}

/// Hash of all that a picture of the built-in scene depends on.
pub(crate) fn demo_content() -> Digest {
    static CONTENT: OnceLock<Digest> = OnceLock::new();
    *CONTENT.get_or_init(|| {
        let scene = DemoScene::unpack().expect("the scene unpacks");
        Model::open(scene.path()).expect("the scene opens").content()
    })
}

/// Two frames from one side.
pub(crate) fn cameras() -> CameraSet {
    let size = FrameSize::new(SIDE_PX, SIDE_PX).expect("a size");
    let lens = Lens { fov_x_rad: 0.7, size };
    let orbit = Orbit { views: 1, elevation_deg: 20.0, look_at: LookAt::D_NERF, lens };
    orbit.cameras().expect("an orbit").at_times(&[0.0, 0.5])
}

/// The owner's key file.
pub(crate) fn key_file(clip: &ClipModel) -> TensorFile {
    key_file_of(clip, SECRET, BITS)
}

/// The key file of anyone, of any length.
pub(crate) fn key_file_of(clip: &ClipModel, secret: [u8; 32], bits: u32) -> TensorFile {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let path = folder.path().join("owner.key");
    key_of(clip, secret, bits).write(&path, Existing::Refuse).expect("writable");
    TensorFile::read(&path).expect("written above")
}

/// Anyone's key with a decoder that reads without training: its logits are what a linear map makes of text features,
/// the one that gives back each bit's part in them.
pub(crate) fn key_of(clip: &ClipModel, secret: [u8; 32], bits: u32) -> Key {
    let mut key = Key::untrained(clip, MasterSecret::from_bytes(secret), bits).expect("the vocabulary is large");
    let (bits, width) = (key.bits(), key.text_mean.len());
    let codes = DMatrix::from_row_slice(bits, width, &key.codes);
    let inverse = codes.pseudo_inverse(1e-6).expect("codes differ");
    let layers = &mut key.decoder.layers;
    let hidden = layers[0].outputs;
    for bit in 0..bits {
        let column = inverse.column(bit) * LOGIT_PER_CODE;
        let middle = column.iter().zip(&key.text_mean).map(|(w, m)| w * m).sum::<f32>();
        // Each bit has two hidden units of opposite sign, and GELU(x) - GELU(-x) = x.
        for (unit, sign) in [(2 * bit, 1.0), (2 * bit + 1, -1.0)] {
            let row = &mut layers[0].weight[unit * width..][..width];
            row.iter_mut().zip(column.iter()).for_each(|(weight, w)| *weight = sign * w);
            layers[0].bias[unit] = -sign * middle;
            layers[1].weight[unit * hidden + 2 * bit] = sign;
            layers[1].weight[unit * hidden + 2 * bit + 1] = -sign;
            layers[2].weight[bit * hidden + unit] = sign;
        }
    }
    key
}

/// A key file with the hash of its content as it is now.
pub(crate) fn sealed(mut file: TensorFile) -> TensorFile {
    file.meta.remove("content");
    let content = Digest::of(&file.to_bytes().expect("serialises")).to_string();
    file.meta.insert("content".to_owned(), content);
    file
}

/// A folder with `owner.key` and the delivery of one embedding in `out`, made once per process.
pub(crate) fn delivered(gpu: &Gpu) -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("owner");
        if folder.exists() {
            std::fs::remove_dir_all(&folder).expect("an earlier run's folder can be removed");
        }
        let owner = Owner::new(gpu);
        owner.owner_key.write(&folder.join("owner.key"), Existing::Refuse).expect("writable");
        let mut embedding = owner.prepare(gpu);
        embedding.step().expect("steps");
        owner.deliver(gpu, &embedding.finish().expect("finishes"), &folder.join("out"));
        folder
    })
}
