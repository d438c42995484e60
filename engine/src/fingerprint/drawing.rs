//! How a film was drawn: by whose renderer, on what background, how finely. And the original, drawn alike.

use guard4d_kernels::splat::rules::Framebuffer;
use guard4d_kernels::{Buffer, Device};

use crate::error::EngineError;
use crate::render::deform::DeformField;
use crate::render::making::Making;
use crate::render::settings::Settings;
use crate::render::{Frame as FrameOfClip, FrameMut, FramePlan, OffsetBases, Offsets, Prune, Renderer};
use crate::scene::{Camera, FrameSize, Model};

/// Only the DC terms are asked about.
pub(super) const BASES: OffsetBases = OffsetBases::Dc;

/// How a film was drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// By whose renderer, and how finely.
    pub making: Making,
    /// What stands behind the asset.
    pub background: [f32; 3],
}

impl Look {
    /// As the model's own pictures are.
    #[must_use]
    pub fn of(model: &Model) -> Self {
        Self { making: Making::default(), background: model.background }
    }
}

/// The original as one renderer has it.
#[derive(Debug)]
pub(super) struct Painter {
    settings: Settings,
    device: Device,
    field: DeformField,
    renderer: Renderer,
}

/// A view that is drawn again and again.
#[derive(Debug)]
pub(super) struct Drawn {
    plan: FramePlan,
    pub look: Look,
}

impl Painter {
    /// # Errors
    /// When memory runs out or the device fails.
    pub(super) fn new(device: &Device, model: &Model, settings: Settings) -> Result<Self, EngineError> {
        let profile = settings.profile();
        Ok(Self {
            settings,
            device: device.clone(),
            field: profile.upload(device, &model.gaussians, &model.motion)?,
            renderer: Renderer::new(device)?.with_rules(profile.rules),
        })
    }

    /// At other settings, which keep the same splats.
    pub(super) fn at(self, settings: Settings) -> Self {
        Self { settings, renderer: self.renderer.with_rules(settings.profile().rules), ..self }
    }

    /// How it draws.
    pub(super) fn settings(&self) -> Settings {
        self.settings
    }

    /// What draws a view at a time.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub(super) fn plan(&mut self, camera: &Camera, time: f32, look: Look) -> Result<Drawn, EngineError> {
        let times = look.making.times;
        let size = FrameSize::new(camera.width * times, camera.height * times)?;
        let state = self.field.at(time)?;
        let plan = self.renderer.plan(&state, &camera.resized(size), Prune::Keep)?;
        Ok(Drawn { plan: self.renderer.fix_view(plan)?, look })
    }

    /// A picture `[H, W, 4]` of the asset, with all that its renderer rounds; the last channel is the final
    /// transmittance.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub(super) fn draw(&mut self, drawn: &Drawn) -> Result<Vec<f32>, EngineError> {
        self.run(drawn, None)
    }

    /// The same with offsets of its DC terms, as if no framebuffer rounded anything: linear in the colours.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub(super) fn draw_linear(&mut self, drawn: &Drawn, offsets: &Buffer<f32>) -> Result<Vec<f32>, EngineError> {
        self.run(drawn, Some(offsets))
    }

    fn run(&mut self, drawn: &Drawn, linear_with: Option<&Buffer<f32>>) -> Result<Vec<f32>, EngineError> {
        let Drawn { plan, look } = drawn;
        let mut pixels = self.device.buffer("film.frame", plan.frame_len())?;
        let mut rec = self.device.recorder()?;
        let frame = FrameMut { clip: &mut pixels, index: 0 };
        match linear_with {
            None => self.renderer.forward(&mut rec, plan, None, look.background, frame)?,
            Some(data) => {
                let offsets = Some(Offsets { data, bases: BASES });
                self.renderer.forward_linear(&mut rec, plan, offsets, look.background, frame)?;
            }
        }
        rec.submit()?;
        Ok(made_smaller(pixels.read()?, drawn))
    }

    /// Whether [`Painter::draw`] rounds what [`Painter::draw_linear`] does not.
    pub(super) fn rounds(&self) -> bool {
        self.settings.profile().rules.framebuffer == Framebuffer::Bytes
    }

    /// Adds what a picture says of each splat's offsets: the transpose of [`Painter::draw_linear`].
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub(super) fn back(
        &mut self,
        drawn: &Drawn,
        offsets: &Buffer<f32>,
        v_picture: Vec<f32>,
        v_offsets: &mut Buffer<f32>,
    ) -> Result<(), EngineError> {
        let v_frame = self.device.buffer_from("film.v_frame", &spread(v_picture, drawn))?;
        let offsets = Offsets { data: offsets, bases: BASES };
        let mut rec = self.device.recorder()?;
        let v_frame = FrameOfClip { clip: &v_frame, index: 0 };
        self.renderer.backward(&mut rec, &drawn.plan, offsets, v_frame, v_offsets)?;
        rec.submit()?;
        Ok(())
    }
}

/// Means of the pixels `[H, W, 4]` that become one.
fn made_smaller(pixels: Vec<f32>, drawn: &Drawn) -> Vec<f32> {
    let (times, width) = (drawn.look.making.times as usize, drawn.plan.width() as usize);
    if times == 1 {
        return pixels;
    }
    let mut small = vec![0.0; pixels.len() / (times * times)];
    for (at, pixel) in pixels.chunks_exact(4).enumerate() {
        let to = (at / width / times) * (width / times) + at % width / times;
        small[4 * to..4 * to + 4].iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value / (times * times) as f32);
    }
    small
}

/// The transpose of [`made_smaller`].
fn spread(small: Vec<f32>, drawn: &Drawn) -> Vec<f32> {
    let (times, width) = (drawn.look.making.times as usize, drawn.plan.width() as usize);
    if times == 1 {
        return small;
    }
    let mut pixels = vec![0.0; small.len() * times * times];
    for (at, pixel) in pixels.chunks_exact_mut(4).enumerate() {
        let from = (at / width / times) * (width / times) + at % width / times;
        pixel.iter_mut().zip(&small[4 * from..]).for_each(|(value, sum)| *value = sum / (times * times) as f32);
    }
    pixels
}
