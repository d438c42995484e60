//! How the cost of planning, rendering and differentiating clips grows with views, frames and splats.

use std::sync::Arc;
use std::time::Instant;

use guard4d_engine::error::EngineError;
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::render::{FramePlan, OffsetBases, Offsets, Prune, Renderer};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Camera, Model, Motion};
use guard4d_kernels::{Buffer, Device};

use crate::harness::{Bench, Outcome, Scale, Work, scene};

/// Factors that every axis is stretched by.
const FACTORS: [usize; 5] = [1, 2, 4, 8, 16];
const SIDE: u32 = 200;
/// Sizes of the other axes.
const FRAMES: usize = 4;
const VIEWS: usize = 2;
/// Fewest splats; with fewer the pixels would hide them.
const SPLATS: usize = 8192;
const BACKGROUND: [f32; 3] = [0.0; 3];

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    clips(bench)?;
    splats(bench)
}

/// Views and frames of the scene that ships with the program. All look through one camera, but each is planned anew:
/// what a view happens to see must not pass for scaling.
fn clips(bench: &mut Bench) -> Outcome {
    let demo = DemoScene::unpack()?;
    let model = Model::open(demo.path())?;
    let camera = demo.cameras((SIDE, SIDE))?.clips()[0][0].0;
    let field = DeformField::new(&bench.device, &model.gaussians, &model.motion)?;
    let mut job = Job::new(&bench.device, field)?;
    for axis in ["V", "F"] {
        for factor in FACTORS {
            let (views, frames) = if axis == "V" { (factor, FRAMES) } else { (VIEWS, factor) };
            let clip: Vec<_> = (0..frames).map(|k| (camera, k as f32 / frames as f32)).collect();
            let name =
                format!("scaling/{axis} {views} views of {frames} frames, demo scene, {SIDE}x{SIDE}, wall clock");
            job.row(bench, &name, Scale { axis, size: factor as f64 }, &vec![clip; views])?;
        }
    }
    Ok(())
}

/// Splats in one frame.
fn splats(bench: &mut Bench) -> Outcome {
    let camera = scene::camera(SIDE)?;
    for factor in FACTORS {
        let count = factor * SPLATS;
        let name = format!("scaling/N {count} splats, one frame, {SIDE}x{SIDE}, wall clock");
        if bench.wants(&name) {
            let field = DeformField::new(&bench.device, &scene::splats(count, &camera), &Motion::Still)?;
            let scale = Scale { axis: "N", size: count as f64 };
            Job::new(&bench.device, field)?.row(bench, &name, scale, &[vec![(camera, 0.0)]])?;
        }
    }
    Ok(())
}

/// What all runs of one scene share.
struct Job {
    device: Device,
    field: DeformField,
    renderer: Renderer,
    offsets: Buffer<f32>,
    v_offsets: Buffer<f32>,
}

impl Job {
    fn new(device: &Device, field: DeformField) -> Result<Self, EngineError> {
        let floats = OffsetBases::Dc.floats() * field.len();
        Ok(Self {
            device: device.clone(),
            field: field.with_cached_times(FACTORS[FACTORS.len() - 1]),
            renderer: Renderer::new(device)?,
            offsets: device.buffer("offsets", floats)?,
            v_offsets: device.buffer("v_offsets", floats)?,
        })
    }

    fn row(&mut self, bench: &mut Bench, name: &str, scale: Scale, clips: &[Vec<(Camera, f32)>]) -> Outcome {
        let longest = clips.iter().map(Vec::len).max().unwrap_or(0);
        let mut frames = self.device.buffer("frames", longest * (4 * SIDE * SIDE) as usize)?;
        let row = bench.samples(name, Work::Mixed, || {
            let started = Instant::now();
            for clip in clips {
                self.run(clip, &mut frames)?;
            }
            Ok(started.elapsed())
        })?;
        if let Some(row) = row {
            row.scale = Some(scale);
        }
        Ok(())
    }

    /// Plans a clip, renders it and differentiates it. The moments of a moving scene are all known after the first run.
    fn run(&mut self, clip: &[(Camera, f32)], frames: &mut Buffer<f32>) -> Outcome {
        let mut plans: Vec<Arc<FramePlan>> = Vec::new();
        for (camera, time) in clip {
            let state = self.field.at(*time)?;
            plans.push(Arc::new(self.renderer.plan(&state, camera, Prune::Remove)?));
        }
        let offsets = Offsets { data: &self.offsets, bases: OffsetBases::Dc };
        let mut rec = self.device.recorder()?;
        self.renderer.forward_clip(&mut rec, &plans, Some(offsets), BACKGROUND, frames)?;
        self.renderer.backward_clip(&mut rec, &plans, offsets, frames, &mut self.v_offsets)?;
        rec.submit()?;
        Ok(())
    }
}
