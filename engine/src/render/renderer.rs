//! Builds the plans of views and runs them: colours in, pixels out, and the gradient back to the colours.

use std::sync::Arc;

use guard4d_kernels::shape::OffsetBases;
use guard4d_kernels::splat::dc_colour;
use guard4d_kernels::splat::project::View;
use guard4d_kernels::splat::rasterize::{self, BackwardScratch, Frame, FrameMut};
use guard4d_kernels::splat::rules::{Framebuffer, Rules, SortKey};
use guard4d_kernels::splat::sh::{self, ShInputs};
use guard4d_kernels::splat::tile_bin::{Prune, TileBinner};
use guard4d_kernels::{Buffer, Device, Recorder};

use super::plan::FramePlan;
use crate::error::EngineError;
use crate::render::deform::SplatState;
use crate::scene::Camera;

/// Additive offsets on the SH coefficients.
#[derive(Clone, Copy, Debug)]
pub struct Offsets<'a> {
    /// N rows.
    pub data: &'a Buffer<f32>,
    /// Which coefficients have offsets, and so what a row is.
    pub bases: OffsetBases,
}

/// Builds frame plans and runs them. Its working memory grows when a plan is built, never when one runs.
#[derive(Debug)]
pub struct Renderer {
    device: Device,
    rules: Rules,
    binner: TileBinner,
    colours: Buffer<f32>,
    v_colours: Buffer<f32>,
    backward: BackwardScratch,
}

impl Renderer {
    /// A renderer on `device` that draws as the reference does.
    ///
    /// # Errors
    /// When device memory runs out.
    pub fn new(device: &Device) -> Result<Self, EngineError> {
        Ok(Self {
            device: device.clone(),
            rules: Rules::REFERENCE,
            binner: TileBinner::new(device)?,
            colours: device.buffer("render.colours", 0)?,
            v_colours: device.buffer("render.v_colours", 0)?,
            backward: BackwardScratch::new(device, 0)?,
        })
    }

    /// Draws by other rules from now on: plans keep those that they were made by.
    #[must_use]
    pub fn with_rules(mut self, rules: Rules) -> Self {
        self.rules = rules;
        self
    }

    /// Everything about a view that does not depend on colours; runs at once and waits.
    ///
    /// # Errors
    /// When the image is empty or too large, memory runs out, or the device fails.
    #[tracing::instrument(skip_all, fields(width = camera.width, height = camera.height))]
    pub fn plan(&mut self, state: &SplatState, camera: &Camera, prune: Prune) -> Result<FramePlan, EngineError> {
        if self.rules.sort_key == SortKey::Buckets {
            state.make_buckets(&self.device)?;
        }
        let (lists, timings) = self.binner.build(&view(camera, self.rules), state.raw(), state.len(), prune)?;
        let plan = FramePlan::new(lists, Arc::clone(state.sh_coeffs()), state.sh_degree());
        tracing::debug!(
            visible = plan.num_visible(),
            isects = plan.num_isects(),
            bytes = plan.bytes(),
            device_us = timings.total().as_micros(),
            "frame planned"
        );
        self.reserve(&plan)?;
        Ok(plan)
    }

    /// A plan that is run with offsets of the DC terms or with none: what else makes up the colours is worked out now
    /// and kept instead of the view directions, so that a run reads 32 bytes for each splat instead of 200. Pays for
    /// plans that run more than once.
    ///
    /// # Errors
    /// When device memory runs out or the device fails.
    pub fn fix_view(&self, mut plan: FramePlan) -> Result<FramePlan, EngineError> {
        let mut rec = self.device.recorder()?;
        let mut base = rec.zeros("plan.base", 4 * plan.num_visible())?;
        let none = rec.zeros("plan.no_dirs", 0)?;
        sh::before_clamp(&mut rec, &sh_inputs(&plan, None), &plan.visible(), &mut base)?;
        rec.submit()?;
        plan.keep_base(base, none);
        Ok(plan)
    }

    /// Makes room for running `plan`, for plans that another renderer built.
    ///
    /// # Errors
    /// When device memory runs out.
    pub fn reserve(&mut self, plan: &FramePlan) -> Result<(), EngineError> {
        let colours = 4 * plan.num_visible();
        if self.colours.len() < colours {
            let buffer = |name| self.device.buffer(name, colours);
            (self.colours, self.v_colours) = (buffer("render.colours")?, buffer("render.v_colours")?);
        }
        if self.backward.capacity() < plan.num_isects() {
            self.backward = BackwardScratch::new(&self.device, plan.num_isects())?;
        }
        Ok(())
    }

    /// Renders one frame with the scene's coefficients plus `offsets` into its place in a clip `[F,H,W,4]`:
    /// rgb over `background`, not clamped unless the framebuffer of the plan's rules is one of 8 bits, and the final
    /// transmittance.
    ///
    /// # Errors
    /// [`guard4d_kernels::KernelError::Shape`] when a buffer is too short, or offsets beside the DC terms meet a fixed
    /// view.
    pub fn forward(
        &mut self,
        rec: &mut Recorder,
        plan: &FramePlan,
        offsets: Option<Offsets<'_>>,
        background: [f32; 3],
        frame: FrameMut<'_>,
    ) -> Result<(), EngineError> {
        self.colour(rec, plan, offsets)?;
        match plan.lists.rules.framebuffer {
            Framebuffer::Floats => rasterize::forward(rec, &plan.lists, &self.colours, background, frame)?,
            Framebuffer::Bytes => rasterize::forward_in_bytes(rec, &plan.lists, &self.colours, background, frame)?,
        }
        Ok(())
    }

    /// The same as if nothing were rounded in any framebuffer: linear in the colours, and what [`Self::backward`] is
    /// the transpose of.
    ///
    /// # Errors
    /// As [`Renderer::forward`].
    pub fn forward_linear(
        &mut self,
        rec: &mut Recorder,
        plan: &FramePlan,
        offsets: Option<Offsets<'_>>,
        background: [f32; 3],
        frame: FrameMut<'_>,
    ) -> Result<(), EngineError> {
        self.colour(rec, plan, offsets)?;
        rasterize::forward(rec, &plan.lists, &self.colours, background, frame)?;
        Ok(())
    }

    /// Works out the colours of a plan's splats.
    fn colour(
        &mut self,
        rec: &mut Recorder,
        plan: &FramePlan,
        offsets: Option<Offsets<'_>>,
    ) -> Result<(), EngineError> {
        match (plan.base_colours(), offsets) {
            (Some(base), None) => dc_colour::forward(rec, &base, None, &mut self.colours)?,
            (Some(base), Some(Offsets { data, bases: OffsetBases::Dc })) => {
                dc_colour::forward(rec, &base, Some(data), &mut self.colours)?;
            }
            // Without directions a fixed view is refused for offsets that turn with it.
            _ => sh::forward(rec, &sh_inputs(plan, offsets), &plan.visible(), &mut self.colours)?,
        }
        Ok(())
    }

    /// Renders consecutive frames of a clip, the first at frame 0.
    ///
    /// # Errors
    /// As [`Renderer::forward`].
    pub fn forward_clip(
        &mut self,
        rec: &mut Recorder,
        plans: &[Arc<FramePlan>],
        offsets: Option<Offsets<'_>>,
        background: [f32; 3],
        clip: &mut Buffer<f32>,
    ) -> Result<(), EngineError> {
        for (index, plan) in plans.iter().enumerate() {
            self.forward(rec, plan, offsets, background, FrameMut { clip, index })?;
        }
        Ok(())
    }

    /// Adds the gradient of one frame to `v_offsets`, laid out like `offsets`; which colours are clamped is found
    /// anew from them. The fourth channel of the frame is unread.
    ///
    /// # Errors
    /// [`guard4d_kernels::KernelError::Shape`] when a buffer is too short.
    pub fn backward(
        &mut self,
        rec: &mut Recorder,
        plan: &FramePlan,
        offsets: Offsets<'_>,
        v_frame: Frame<'_>,
        v_offsets: &mut Buffer<f32>,
    ) -> Result<(), EngineError> {
        rasterize::backward(rec, &plan.lists, v_frame, &mut self.backward, &mut self.v_colours)?;
        match (plan.base_colours(), offsets.bases) {
            (Some(base), OffsetBases::Dc) => {
                dc_colour::backward(rec, &base, offsets.data, &self.v_colours, v_offsets)?;
            }
            _ => sh::backward(rec, &sh_inputs(plan, Some(offsets)), &plan.visible(), &self.v_colours, v_offsets)?,
        }
        Ok(())
    }

    /// Adds the gradients of consecutive frames of a clip, the first at frame 0.
    ///
    /// # Errors
    /// As [`Renderer::backward`].
    pub fn backward_clip(
        &mut self,
        rec: &mut Recorder,
        plans: &[Arc<FramePlan>],
        offsets: Offsets<'_>,
        v_clip: &Buffer<f32>,
        v_offsets: &mut Buffer<f32>,
    ) -> Result<(), EngineError> {
        for (index, plan) in plans.iter().enumerate() {
            self.backward(rec, plan, offsets, Frame { clip: v_clip, index }, v_offsets)?;
        }
        Ok(())
    }
}

fn sh_inputs<'a>(plan: &'a FramePlan, offsets: Option<Offsets<'a>>) -> ShInputs<'a> {
    ShInputs {
        sh_coeffs: &plan.sh_coeffs,
        offsets: offsets.map(|o| (o.data, o.bases)),
        degree: plan.sh_degree,
        max_colour: plan.lists.rules.max_colour,
    }
}

/// The camera as the projection takes it.
fn view(camera: &Camera, rules: Rules) -> View {
    let rows = camera.world_to_camera.transpose().to_cols_array_2d();
    View {
        world_to_camera: [rows[0], rows[1], rows[2]],
        focal: [camera.fx, camera.fy],
        centre: [camera.cx, camera.cy],
        width: camera.width,
        height: camera.height,
        rules,
    }
}
