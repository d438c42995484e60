//! Moving, planning, rendering and differentiating one frame of the embedded scene.

use std::time::Instant;

use guard4d_engine::error::EngineError;
use guard4d_engine::render::deform::{DeformField, SplatState};
use guard4d_engine::render::{Frame, FrameMut, OffsetBases, Prune};
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Camera, Model, Motion};
use guard4d_kernels::Buffer;
use guard4d_kernels::splat::SH_FLOATS;
use guard4d_kernels::splat::bucket;
use guard4d_kernels::splat::dc_colour::{self, BaseColours};
use guard4d_kernels::splat::deform::{self, ALL_COLUMNS, DeformedOut, Heads, RotationUpdate};
use guard4d_kernels::splat::hexplane::{self, Plane, Planes};
use guard4d_kernels::splat::project::{self, Buckets, Projection, View};
use guard4d_kernels::splat::rasterize::{self, BackwardScratch};
use guard4d_kernels::splat::rules::Rules;
use guard4d_kernels::splat::sh::{self, ShInputs, VisibleSplats};
use guard4d_kernels::splat::tile_bin::{TileBinner, VisibleLists};
use guard4d_kernels::splat::trajectory::{self, PATH_FLOATS, Paths};
use guard4d_kernels::splat::warp::{self, Shift, WARP_COLUMNS};

use crate::harness::{Bench, Outcome, Work, scene};

const SIDE: u32 = 400;
/// Splats and image sides of the made scenes: those that targets are about, and a model as D-NeRF's recipe leaves it.
const MADE: [(usize, u32); 3] = [(50_000, 400), (50_000, 800), (30_000, 800)];

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let scene = DemoScene::unpack()?;
    let model = Model::open(scene.path())?;
    let clips = scene.cameras((SIDE, SIDE))?.clips();
    let (camera, time) = clips[0][0];
    let mut field = DeformField::new(&bench.device, &model.gaussians, &model.motion)?;
    moments(bench, &model, field.canonical(), time)?;
    let state = field.at(time)?;
    let lists = plan(bench, &state, &view(&camera))?;
    for bases in [OffsetBases::Dc, OffsetBases::All] {
        colours(bench, &state, &lists, bases)?;
    }
    fixed_colours(bench, state.len(), &lists)?;
    let label = format!("demo scene, {SIDE}x{SIDE}");
    blend(bench, &label, model.background, &lists)?;
    for (count, side) in MADE {
        made(bench, count, side)?;
    }
    Ok(())
}

fn made(bench: &mut Bench, count: usize, side: u32) -> Outcome {
    let camera = scene::camera(side)?;
    let splats = scene::splats(count, &camera);
    let field = DeformField::new(&bench.device, &splats, &Motion::Still)?;
    let state = field.canonical();
    let (lists, _) = TileBinner::new(&bench.device)?.build(&view(&camera), state.raw(), state.len(), Prune::Remove)?;
    let label = format!("{}k, {side}x{side}", count / 1000);
    blend(bench, &label, [0.0; 3], &lists)?;
    let picture = whole(bench, &label, state, &camera)?;
    match &bench.scenes {
        Some(folder) => scene::write(&folder.join(format!("{label}.safetensors")), &splats, &camera, picture.read()?),
        None => Ok(()),
    }
}

/// A picture from splats alone, as somebody who looks at a scene from one place after another needs it: lists, colours
/// and pixels. By the clock on the wall, because the host reads lengths of lists in between.
fn whole(bench: &mut Bench, scene: &str, state: &SplatState, camera: &Camera) -> Result<Buffer<f32>, EngineError> {
    let device = bench.device.clone();
    let (view, n) = (view(camera), state.len());
    let mut binner = TileBinner::new(&device)?;
    let count = binner.build(&view, state.raw(), n, Prune::Remove)?.0.num_visible;
    let mut colours = device.buffer("colours", 4 * count)?;
    let mut picture = device.buffer("frame", 4 * camera.width as usize * camera.height as usize)?;
    let sh =
        ShInputs { sh_coeffs: state.sh_coeffs(), offsets: None, degree: state.sh_degree(), max_colour: f32::INFINITY };
    let mut once = || {
        let started = Instant::now();
        let (lists, _) = binner.build(&view, state.raw(), n, Prune::Remove)?;
        let mut rec = device.recorder()?;
        let visible = VisibleSplats { dirs: &lists.dirs, splat_from_visible: &lists.splat_from_visible, count };
        sh::forward(&mut rec, &sh, &visible, &mut colours)?;
        rasterize::forward(&mut rec, &lists, &colours, [0.0; 3], FrameMut { clip: &mut picture, index: 0 })?;
        rec.submit()?;
        Ok(started.elapsed())
    };
    bench.samples(&format!("splat/forward {scene}, wall clock"), Work::Mixed, &mut once)?;
    if bench.scenes.is_some() {
        once()?;
    }
    Ok(picture)
}

/// The parts of the deformation network that are no matrix product.
fn moments(bench: &mut Bench, model: &Model, state: &SplatState, time: f32) -> Outcome {
    let weights = model.motion.network().ok_or_else(|| EngineError::Usage {
        what: "embedded scene".to_owned(),
        got: "no deformation".to_owned(),
        expected: "one that moves".to_owned(),
    })?;
    let n = state.len();
    let channels = weights.config.output_coordinate_dim;
    let plane = |p: &guard4d_engine::scene::deformation::Plane| (p.width, p.height);
    let sizes: Vec<_> = weights.grids.iter().flatten().map(plane).collect();
    let data = weights.grids.iter().flatten().map(|p| p.data.as_slice());
    let planes: Vec<_> = data.zip(sizes).map(|(data, (width, height))| Plane { data, width, height }).collect();
    let planes = Planes::new(&bench.device, &planes, channels, weights.aabb)?;
    let mut features = bench.device.buffer("features", n * planes.features())?;
    let work = Work::Bytes((4 * n * (4 + 25 * planes.features())) as f64, "4·N·(4 + (6·4+1)·L·C), no cache");
    bench.passes(&format!("splat/hexplane {n} splats, {} features", planes.features()), work, |rec| {
        hexplane::forward(rec, &planes, state.raw().means, time, &mut features)
    })?;

    let columns = ALL_COLUMNS.next_multiple_of(8);
    let head_values = bench.data("heads", n * columns)?;
    let heads = Heads { data: &head_values, columns };
    let part = |name: &str| bench.device.buffer(name, 4 * n);
    let [mut means, mut scales, mut quats] = [part("means")?, part("scales")?, part("quats")?];
    bench.passes(&format!("splat/deform_apply {n} splats"), Work::Bytes((144 * n) as f64, "9·16·N"), |rec| {
        let out = DeformedOut { means: &mut means, scales: &mut scales, quats: &mut quats };
        deform::apply(rec, state.raw(), heads, RotationUpdate::Add, out)
    })?;
    let warp_heads = bench.data("warp heads", n * WARP_COLUMNS)?;
    bench.passes(&format!("splat/warp {n} splats"), Work::Bytes((160 * n) as f64, "10·16·N"), |rec| {
        let out = DeformedOut { means: &mut means, scales: &mut scales, quats: &mut quats };
        warp::apply(rec, state.raw(), &warp_heads, Shift::Offset, out)
    })?;
    let paths = bench.data("paths", n * PATH_FLOATS)?;
    bench.passes(&format!("splat/trajectory {n} splats"), Work::Bytes((128 * n) as f64, "8·16·N"), |rec| {
        let splats = Paths { means: state.raw().means, quats: state.raw().quats, paths: &paths };
        trajectory::forward(rec, splats, time, &mut means, &mut quats)
    })?;
    let mut sh_coeffs = bench.device.buffer("deformed_sh", SH_FLOATS * n)?;
    let work = Work::Bytes((3 * 4 * SH_FLOATS * n) as f64, "3·4·48·N");
    bench.passes(&format!("splat/deform_sh {n} splats"), work, |rec| {
        deform::apply_sh(rec, state.sh_coeffs(), heads, &mut sh_coeffs)
    })
}

fn plan(bench: &mut Bench, state: &SplatState, view: &View) -> Result<VisibleLists, EngineError> {
    let n = state.len();
    let mut projection = Projection::new(&bench.device, n)?;
    bench.passes(&format!("splat/project {n} splats"), Work::Bytes((120 * n) as f64, "(48 + 72)·N"), |rec| {
        project::forward(rec, view, state.raw(), n, &mut projection)
    })?;
    let along: Vec<u32> = (0..n).map(|row| row as u32).collect();
    let along = bench.device.buffer_from("along", &along)?;
    let buckets = Buckets { along, corners: [[-1.5; 3], [1.5; 3]] };
    bench.passes(&format!("splat/bucket {n} splats"), Work::Bytes((28 * n) as f64, "(20 + 8)·N"), |rec| {
        bucket::forward(rec, view, &buckets, n, &mut projection)
    })?;
    let mut binner = TileBinner::new(&bench.device)?;
    let (lists, _) = binner.build(view, state.raw(), n, Prune::Remove)?;
    let (visible, pairs) = (lists.num_visible, lists.num_isects);
    let work = Work::Bytes((48 * n + 48 * visible + 8 * pairs) as f64, "48·N + 48·V + 8·I");
    bench.timed(&format!("splat/plan {}", label(state, &lists)), work, || {
        Ok(binner.build(view, state.raw(), n, Prune::Remove)?.1)
    })?;
    Ok(lists)
}

fn label(state: &SplatState, lists: &VisibleLists) -> String {
    let (n, visible, pairs) = (state.len(), lists.num_visible, lists.num_isects);
    format!("demo scene, {SIDE}x{SIDE}, N {n}, V {visible}, I {pairs}")
}

fn colours(bench: &mut Bench, state: &SplatState, lists: &VisibleLists, bases: OffsetBases) -> Outcome {
    let count = lists.num_visible;
    let (row, name) = match bases {
        OffsetBases::Dc => (16, "DC"),
        OffsetBases::All => (192, "all bases"),
    };
    let offsets = bench.data("offsets", bases.floats() * state.len())?;
    let mut v_offsets = bench.device.buffer("v_offsets", offsets.len())?;
    let mut colours = bench.device.buffer("colours", 4 * count)?;
    let v_colours = bench.data("v_colours", 4 * count)?;
    let visible = VisibleSplats { dirs: &lists.dirs, splat_from_visible: &lists.splat_from_visible, count };
    let degree = state.sh_degree();
    let sh =
        ShInputs { sh_coeffs: state.sh_coeffs(), offsets: Some((&offsets, bases)), degree, max_colour: f32::INFINITY };
    let work = Work::Bytes((count * (228 + row)) as f64, "V·(16 + 4 + 192 + offsets + 16)");
    bench.passes(&format!("splat/sh forward {count} splats, degree {degree}, {name}"), work, |rec| {
        sh::forward(rec, &sh, &visible, &mut colours)
    })?;
    let work = Work::Bytes((count * (228 + 3 * row)) as f64, "V·(16 + 4 + 192 + 3·offsets + 16)");
    bench.passes(&format!("splat/sh backward {count} splats, degree {degree}, {name}"), work, |rec| {
        sh::backward(rec, &sh, &visible, &v_colours, &mut v_offsets)
    })
}

/// Colours and their gradient where only the DC terms have offsets.
fn fixed_colours(bench: &mut Bench, n: usize, lists: &VisibleLists) -> Outcome {
    let count = lists.num_visible;
    let (base, offsets) = (bench.data("base", 4 * count)?, bench.data("offsets", 4 * n)?);
    let mut v_offsets = bench.device.buffer("v_offsets", offsets.len())?;
    let mut colours = bench.device.buffer("colours", 4 * count)?;
    let v_colours = bench.data("v_colours", 4 * count)?;
    let (splat_from_visible, max_colour) = (&lists.splat_from_visible, f32::INFINITY);
    let visible = BaseColours { base: &base, splat_from_visible, count, max_colour };
    let work = Work::Bytes((52 * count) as f64, "V·(3·16 + 4)");
    bench.passes(&format!("splat/dc_colour forward {count} splats"), work, |rec| {
        dc_colour::forward(rec, &visible, Some(&offsets), &mut colours)
    })?;
    let work = Work::Bytes((84 * count) as f64, "V·(5·16 + 4)");
    bench.passes(&format!("splat/dc_colour backward {count} splats"), work, |rec| {
        dc_colour::backward(rec, &visible, &offsets, &v_colours, &mut v_offsets)
    })
}

/// Colours to pixels, and the gradient of the pixels back to the colours.
fn blend(bench: &mut Bench, scene: &str, background: [f32; 3], lists: &VisibleLists) -> Outcome {
    let (pixels, pairs) = (lists.grid.num_pixels(), lists.num_isects);
    let label = format!("{scene}, V {}, I {pairs}", lists.num_visible);
    let colours = bench.data("colours", 4 * lists.num_visible)?;
    let mut v_colours = bench.device.buffer("v_colours", colours.len())?;
    let mut clip = bench.device.buffer("frame", 4 * pixels)?;
    let work = Work::Bytes((52 * pairs + 16 * pixels) as f64, "52·I + 16·H·W");
    bench.passes(&format!("splat/rasterize forward {label}"), work, |rec| {
        rasterize::forward(rec, lists, &colours, background, FrameMut { clip: &mut clip, index: 0 })
    })?;
    bench.passes(&format!("splat/rasterize forward in bytes {label}"), work, |rec| {
        rasterize::forward_in_bytes(rec, lists, &colours, background, FrameMut { clip: &mut clip, index: 0 })
    })?;
    let mut scratch = BackwardScratch::new(&bench.device, pairs)?;
    let work = Work::Bytes((72 * pairs + 16 * pixels) as f64, "72·I + 16·H·W");
    bench.passes(&format!("splat/rasterize backward {label}"), work, |rec| {
        rasterize::backward(rec, lists, Frame { clip: &clip, index: 0 }, &mut scratch, &mut v_colours)
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
        rules: Rules::REFERENCE,
    }
}
