//! The gradient of the message loss with respect to the offsets, through an image tower of ViT-B/32's size.

use std::sync::Arc;

use guard4d_engine::clip::Purpose;
use guard4d_engine::deform::DeformField;
use guard4d_engine::render::{FramePlan, OffsetBases, Offsets, Prune, Renderer};
use guard4d_engine::scene::camera_paths::{Lens, Orbit};
use guard4d_engine::scene::ImageSize;
use guard4d_engine::watermark::decoder::{Decoder, DecoderPass};
use guard4d_engine::watermark::extractor::{CLIP_FRAMES, FeatureExtractor, Training};
use guard4d_engine::watermark::prf::Purpose as Stream;
use guard4d_engine::watermark::tmsd::{TmsdConfig, TmsdWeights};
use guard4d_kernels::image::resize::{self, Onward, ResizePlan};
use guard4d_kernels::loss::bce::{self, Groups, Objective};
use guard4d_kernels::{Buffer, Device};

use crate::clip::vit_b32;
use crate::support::gpu::device;
use crate::support::owner::{BITS, Owner};
use crate::support::random::Random;

const SIDE_PX: u32 = 64;
/// Change of the loss that the two ends of a difference are to have.
const CHANGE: f32 = 2e-2;

/// Offsets → frames → CLIP's size → R → tower → decoder → loss, as in a step of `joint` but for the rounding to 8 bits, which
/// passes gradients through and so has no difference to compare with.
struct Way<'a> {
    gpu: &'a Device,
    renderer: Renderer,
    plans: Vec<Arc<FramePlan>>,
    background: [f32; 3],
    offsets: Buffer<f32>,
    raw: Buffer<f32>,
    resize: ResizePlan,
    scratch: Buffer<f32>,
    resized: Buffer<f32>,
    features: FeatureExtractor,
    decoder: Decoder,
    pass: DecoderPass,
    target: Buffer<f32>,
    value: Buffer<f32>,
}

const GROUPS: Groups = Groups { groups: 1, rows: CLIP_FRAMES, bits: BITS as usize };

impl<'a> Way<'a> {
    fn new(gpu: &'a Device, owner: &Owner) -> Self {
        let model = &owner.model;
        let size = ImageSize::new(SIDE_PX, SIDE_PX).expect("a size");
        let lens = Lens { fov_x_rad: 0.7, size };
        let orbit = Orbit { views: 1, elevation_deg: 20.0, radius: 4.0, target: glam::Vec3::ZERO, lens };
        let times: Vec<f32> = (0..CLIP_FRAMES).map(|i| i as f32 / CLIP_FRAMES as f32).collect();
        let mut field = DeformField::new(gpu, &model.gaussians, model.deformation.as_ref()).expect("uploads");
        let mut renderer = Renderer::new(gpu).expect("renderer");
        let mut plans = Vec::new();
        for (_, camera, time) in orbit.cameras().expect("an orbit").at_times(&times).entries() {
            let state = field.at(time).expect("deforms");
            plans.push(Arc::new(renderer.plan(&state, camera, Prune::Remove).expect("plans")));
        }
        let clip = vit_b32::clip(gpu, vit_b32::IMAGES);
        let mut random = Random(3);
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut stream = owner.key.prf().stream(Stream::TmsdInit, 0);
        let mut tmsd = TmsdWeights::new(TmsdConfig::default(), identity, &mut stream);
        // Of a network whose last layer is zero nothing but the colour map would be tried.
        let last = tmsd.layers.last_mut().expect("three layers");
        *last = random.vec_f32(last.len(), -0.05, 0.05);
        let features =
            FeatureExtractor::new(gpu, &clip, Some(&tmsd), 1, Purpose::InputGradient).expect("extractor");
        let (small, frames) = (features.side(), size.height as usize * size.width as usize);
        let to = resize::ImageSize { height: small, width: small };
        let from = resize::ImageSize { height: SIDE_PX as usize, width: SIDE_PX as usize };
        let resize = ResizePlan::new(gpu, from, to).expect("plan");
        let decoder = Decoder::new(gpu, &owner.key.decoder).expect("decoder");
        let bits: Vec<f32> = owner.message.bits().map(|bit| f32::from(u8::from(bit))).collect();
        let count = model.gaussians.len() * OffsetBases::Dc.floats();
        Self {
            gpu,
            renderer,
            plans,
            background: model.background,
            offsets: gpu.buffer_from("offsets", &random.vec_f32(count, -0.05, 0.05)).expect("buffer"),
            raw: gpu.buffer("raw", CLIP_FRAMES * frames * 4).expect("buffer"),
            scratch: resize.scratch(gpu, CLIP_FRAMES).expect("buffer"),
            resize,
            resized: gpu.buffer("resized", features.clip_len()).expect("buffer"),
            pass: decoder.pass(gpu, CLIP_FRAMES).expect("buffers"),
            features,
            decoder,
            target: gpu.buffer_from("target", &bits).expect("buffer"),
            value: gpu.buffer("value", 1).expect("buffer"),
        }
    }

    /// The loss at the offsets as they are.
    fn loss(&mut self) -> f32 {
        let mut rec = self.gpu.recorder().expect("recorder");
        let offsets = Offsets { data: &self.offsets, bases: OffsetBases::Dc };
        let frames = (&self.plans, self.background, &mut self.raw);
        self.renderer.forward_clip(&mut rec, frames.0, Some(offsets), frames.1, frames.2).expect("renders");
        resize::forward(&mut rec, &self.resize, &self.raw, &mut self.resized, &mut self.scratch).expect("records");
        self.features.forward(&mut rec, &[&self.resized]).expect("records");
        self.decoder.forward(&mut rec, self.features.features(), &mut self.pass).expect("records");
        let inputs = (&self.pass.logits, &self.target);
        bce::forward(&mut rec, Objective::Bce, GROUPS, inputs, &mut self.value).expect("records");
        rec.submit().expect("runs");
        self.value.read().expect("reads")[0]
    }

    /// Its gradient; the loss was asked for last.
    fn gradient(&mut self) -> Vec<f32> {
        let mut v_raw = self.gpu.buffer::<f32>("v_raw", self.raw.len()).expect("buffer");
        let mut v_offsets = self.gpu.buffer::<f32>("v_offsets", self.offsets.len()).expect("buffer");
        let mut rec = self.gpu.recorder().expect("recorder");
        let inputs = (&self.pass.logits, &self.target, &self.value);
        bce::backward(&mut rec, (Objective::Bce, 1.0), GROUPS, inputs, &mut self.pass.v_logits).expect("records");
        self.decoder.backward(&mut rec, &mut self.pass).expect("records");
        self.features.backward(&mut rec, &self.pass.v_features, Training::Tmsd).expect("records");
        let into = (&mut v_raw, Onward { plus: None, clamped: None });
        resize::backward(&mut rec, &self.resize, &self.features.v_x, into, &mut self.scratch).expect("records");
        let offsets = Offsets { data: &self.offsets, bases: OffsetBases::Dc };
        self.renderer.backward_clip(&mut rec, &self.plans, offsets, &v_raw, &mut v_offsets).expect("records");
        rec.submit().expect("runs");
        v_offsets.read().expect("reads")
    }
}

#[test]
fn a_difference_along_the_gradient_is_its_length() {
    let Some(gpu) = device() else { return };
    let owner = Owner::new(&gpu);
    let mut way = Way::new(&gpu, &owner);
    let base = way.offsets.read().expect("reads");
    let loss = way.loss();
    let gradient = way.gradient();
    assert!(loss.is_finite() && gradient.iter().all(|v| v.is_finite()), "loss {loss}");
    let length = gradient.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt() as f32;
    assert!(length > 0.0, "the loss depends on the offsets");
    let mut at = |shift: f32| {
        let moved: Vec<f32> = base.iter().zip(&gradient).map(|(b, g)| b + shift * g / length).collect();
        way.offsets.write(&moved).expect("writes");
        f64::from(way.loss())
    };
    let reach = 0.5 * CHANGE / length;
    let slope = (at(reach) - at(-reach)) / (2.0 * f64::from(reach));
    // The rounding of twelve layers in single precision leaves about 1e-5 of a logit, 1e-3 of the difference; colours that
    // pass zero and the third derivative take a few percent more. A gradient that lost a term or a factor is off by more.
    let ratio = slope / f64::from(length);
    assert!((ratio - 1.0).abs() < 0.05, "difference {slope} along a gradient of length {length}: ratio {ratio}");
}
