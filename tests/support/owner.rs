//! An owner with a key, a scene and a small embedding, for tests of the whole way.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::release::delivery::{self, Delivery};
use guard4d_engine::scene::camera::paths::{Lens, Orbit};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{CameraSet, FrameSize, Model};
use guard4d_engine::watermark::embed::{EmbedConfig, Embedded, Embedding, Profile, Subject};
use guard4d_engine::watermark::key::decoder::DecoderWeights;
use guard4d_engine::watermark::key::owner_key::{Key, digest_of};
use guard4d_engine::watermark::key::tokens::{TokenTable, Vocabulary};
use guard4d_kernels::Device;

use super::gpu::Gpu;
use super::random::Random;

/// Message bits of the key.
pub(crate) const BITS: u32 = 8;
/// Side of the training frames in pixels.
const SIDE_PX: u32 = 64;
const SECRET: [u8; 32] = [7; 32];
/// Logit of a written bit of [`reading_key_file`].
const LOGIT_PER_CODE: f32 = 6.0;

/// Everything an embedding needs, made in a moment: the key's decoder is random instead of trained.
pub(crate) struct Owner {
    pub(crate) clip: ClipModel,
    pub(crate) key: Key,
    pub(crate) scene: DemoScene,
    pub(crate) model: Model,
    pub(crate) message: Message,
    pub(crate) config: EmbedConfig,
}

impl Owner {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self::with_key(gpu, key_file)
    }

    /// With a key that reads, of `bits` bits.
    pub(crate) fn reading(gpu: &Gpu, bits: u32) -> Self {
        Self::with_key(gpu, |clip| reading_key_file(clip, SECRET, bits))
    }

    fn with_key(gpu: &Gpu, key_file: impl Fn(&ClipModel) -> TensorFile) -> Self {
        let clip = ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let path = folder.path().join("owner.key");
        std::fs::write(&path, key_file(&clip).to_bytes().expect("serialises")).expect("writable");
        let key = Key::read(&path, &clip).expect("the key fits the checkpoint");
        let scene = DemoScene::unpack().expect("the scene unpacks");
        let model = Model::open(scene.path()).expect("the scene opens");
        let message = key.own_message();
        let config = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind).with(|c| {
            c.optimiser.steps = 4;
            c.views.clips = 2;
            c.views.size_px = (SIDE_PX, SIDE_PX);
            c.extractor.calibration_mut().expect("fitted").probes = 2 * key.bits();
            c.seed = 5;
            c.optimiser.held_out_every = 0;
        });
        Self { clip, key, scene, model, message, config }
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
        let delivery = Delivery { subject, config: &self.config, embedded, input: self.scene.path(), payload: None };
        delivery::write(out, &delivery, &cameras()).expect("delivers");
    }
}

/// Two frames from one side.
pub(crate) fn cameras() -> CameraSet {
    let size = FrameSize::new(SIDE_PX, SIDE_PX).expect("a size");
    let lens = Lens { fov_x_rad: 0.7, size };
    let orbit = Orbit { views: 1, elevation_deg: 20.0, radius: 4.0, target: glam::Vec3::ZERO, lens };
    orbit.cameras().expect("an orbit").at_times(&[0.0, 0.5])
}

/// The owner's key file; its decoder is random.
pub(crate) fn key_file(clip: &ClipModel) -> TensorFile {
    key_file_of(clip, SECRET, 11)
}

/// The key file of anyone, of [`BITS`] bits; its decoder is drawn from `seed`.
pub(crate) fn key_file_of(clip: &ClipModel, secret: [u8; 32], seed: u64) -> TensorFile {
    key_file_with(clip, secret, BITS, seed)
}

/// The same of any length.
pub(crate) fn key_file_with(clip: &ClipModel, secret: [u8; 32], bits: u32, seed: u64) -> TensorFile {
    let hex: String = secret.iter().map(|byte| format!("{byte:02x}")).collect();
    let secret = MasterSecret::from_bytes(secret);
    let (text, width) = (&clip.config().text_config, clip.config().projection_dim);
    let vocabulary = Vocabulary { size: text.vocab_size as u32, context: text.max_position_embeddings as u32 };
    let table = TokenTable::derive(&Prf::new(&secret), vocabulary, bits).expect("the vocabulary is large");
    let mut file = TensorFile::default();
    let entries = [("format", "guard4d.key/1".to_owned()), ("bits", bits.to_string())];
    file.meta.extend(entries.map(|(name, text)| (name.to_owned(), text)));
    file.meta.insert("clip".to_owned(), digest_of(clip).to_string());
    file.meta.insert("secret".to_owned(), hex);
    let ids = table.ids().as_flattened().to_vec();
    file.tensors.insert("token_table".to_owned(), Tensor::u32(&[bits as usize, 2], ids));
    let mut random = Random(seed);
    let mut add = |name: String, shape: &[usize], size: f32| {
        let values = random.vec_f32(shape.iter().product(), -size, size);
        file.tensors.insert(name, Tensor::f32(shape, values));
    };
    add("text_mean".to_owned(), &[width], 0.05);
    add("codes".to_owned(), &[bits as usize, width], 0.05);
    for (i, (inputs, outputs)) in DecoderWeights::sizes(width, bits as usize).into_iter().enumerate() {
        add(format!("decoder.{i}.weight"), &[outputs, inputs], 0.1);
        add(format!("decoder.{i}.bias"), &[outputs], 0.1);
    }
    sealed(file)
}

/// The same with a decoder that reads: its logits are what a linear map makes of the codes, so that nothing needs
/// training.
///
/// Each bit has two hidden units of opposite sign, and GELU(x) − GELU(−x) = x.
pub(crate) fn reading_key_file(clip: &ClipModel, secret: [u8; 32], bits: u32) -> TensorFile {
    let mut file = key_file_with(clip, secret, bits, 11);
    let (bits, width) = (bits as usize, clip.config().projection_dim);
    let codes = file.finite("codes", &[bits, width]).expect("a tensor of keys").to_vec();
    let sizes = DecoderWeights::sizes(width, bits);
    let mut layers = sizes.map(|(inputs, outputs)| vec![0.0; inputs * outputs]);
    for (bit, code) in codes.chunks_exact(width).enumerate() {
        let square: f32 = code.iter().map(|c| c * c).sum();
        for (hidden, sign) in [(2 * bit, 1.0), (2 * bit + 1, -1.0)] {
            for (weight, c) in layers[0][hidden * width..][..width].iter_mut().zip(code) {
                *weight = sign * LOGIT_PER_CODE * c / square;
            }
            layers[1][hidden * sizes[1].0 + 2 * bit] = sign;
            layers[1][hidden * sizes[1].0 + 2 * bit + 1] = -sign;
            layers[2][bit * sizes[2].0 + hidden] = sign;
        }
    }
    for (i, (layer, (inputs, outputs))) in layers.into_iter().zip(sizes).enumerate() {
        file.tensors.insert(format!("decoder.{i}.weight"), Tensor::f32(&[outputs, inputs], layer));
        file.tensors.insert(format!("decoder.{i}.bias"), Tensor::f32(&[outputs], vec![0.0; outputs]));
    }
    sealed(file)
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
        owner.key.write(&folder.join("owner.key"), Existing::Refuse).expect("writable");
        let mut embedding = owner.prepare(gpu);
        embedding.step().expect("steps");
        owner.deliver(gpu, &embedding.finish().expect("finishes"), &folder.join("out"));
        folder
    })
}
