//! Planning, rendering and differentiating one frame of the embedded scene.

use guard4d_engine::deform::DeformField;
use guard4d_engine::demo::Scene;
use guard4d_engine::render::{Frame, FrameMut, OffsetBases, Offsets, Prune, Renderer};
use guard4d_engine::scene::{Camera, Model};
use guard4d_kernels::splat::project::View;
use guard4d_kernels::splat::tile_bin::TileBinner;

use crate::Outcome;
use crate::harness::{Bench, Work};

const SIDE: u32 = 400;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let scene = Scene::unpack()?;
    let model = Model::open(scene.path())?;
    let clips = scene.cameras((SIDE, SIDE))?.clips();
    let (camera, time) = clips[0][0];
    let mut field = DeformField::new(&bench.device, &model.gaussians, model.deformation.as_ref())?;
    let state = field.at(time)?;
    let mut renderer = Renderer::new(&bench.device)?;
    let plan = renderer.plan(&state, &camera, Prune::Remove)?;
    let (splats, visible, pairs) = (state.len(), plan.num_visible(), plan.num_isects());
    let pixels = plan.frame_len() / 4;
    let label = format!("demo scene, {SIDE}x{SIDE}, N {splats}, V {visible}, I {pairs}");

    let mut binner = TileBinner::new(&bench.device)?;
    let work = Work::Bytes((48 * splats + 48 * visible + 8 * pairs) as f64, "48·N + 48·V + 8·I");
    bench.samples(&format!("splat/plan {label}"), work, || {
        Ok(binner.build(&view(&camera), state.raw(), splats, Prune::Remove)?.1.total())
    })?;

    let bases = OffsetBases::Dc;
    let offsets = bench.device.buffer("offsets", bases.floats() * splats)?;
    let mut v_offsets = bench.device.buffer("v_offsets", offsets.len())?;
    let mut frame = bench.device.buffer("frame", plan.frame_len())?;
    let offsets = Offsets { data: &offsets, bases };
    let device = bench.device.clone();
    let work = Work::Bytes((52 * pairs + 16 * pixels) as f64, "52·I + 16·H·W");
    bench.samples(&format!("splat/forward {label}"), work, || {
        let mut rec = device.recorder()?;
        let target = FrameMut { clip: &mut frame, index: 0 };
        renderer.forward(&mut rec, &plan, Some(offsets), model.background, target)?;
        Ok(rec.submit()?.total())
    })?;
    let work = Work::Bytes((72 * pairs + 16 * pixels) as f64, "72·I + 16·H·W");
    bench.samples(&format!("splat/backward {label}"), work, || {
        let mut rec = device.recorder()?;
        renderer.backward(&mut rec, &plan, offsets, Frame { clip: &frame, index: 0 }, &mut v_offsets)?;
        Ok(rec.submit()?.total())
    })
}

/// The camera as the projection takes it.
fn view(camera: &Camera) -> View {
    let rows = camera.world_to_camera.transpose().to_cols_array_2d();
    View {
        world_to_camera: [rows[0], rows[1], rows[2]],
        focal: [camera.fx, camera.fy],
        centre: [camera.cx, camera.cy],
        width: camera.width,
        height: camera.height,
    }
}
