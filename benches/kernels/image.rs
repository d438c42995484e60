//! Operations on clips: the antialiased resize to CLIP's input, and those that take one pixel at a time.

use guard4d_kernels::Buffer;
use guard4d_kernels::image::crop::{self, Cells, Crop, Window};
use guard4d_kernels::image::jpeg::{self, JpegQuality};
use guard4d_kernels::image::noise::{self, Noise};
use guard4d_kernels::image::normalize::{self, Normalization};
use guard4d_kernels::image::resize::{self, ImageSize, Onward, ResizePlan};
use guard4d_kernels::image::warp::{self, Sampling, Warp};
use guard4d_kernels::image::{chroma420, colour_map, levels, quantize};
use guard4d_kernels::shape::ClipShape;

use crate::harness::{Bench, Outcome, Work};

const FRAMES: usize = 8;
const SIDE: usize = 400;
const PIXELS: usize = FRAMES * SIDE * SIDE;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let mut clips = Clips {
        x: bench.data("x", 4 * PIXELS)?,
        v_y: bench.data("v_y", 4 * PIXELS)?,
        out: bench.device.buffer("out", 4 * PIXELS)?,
    };
    resize_clip(bench, &mut clips)?;
    map_pixels(bench, &mut clips)?;
    cut_out(bench, &mut clips)?;
    disturb_pixels(bench, &mut clips)?;
    distort(bench, &mut clips)
}

/// Clips `[F,H,W,4]` of full size.
struct Clips {
    x: Buffer<f32>,
    v_y: Buffer<f32>,
    out: Buffer<f32>,
}

fn resize_clip(bench: &mut Bench, clips: &mut Clips) -> Outcome {
    let to = 64;
    let square = |side| ImageSize { height: side, width: side };
    let plan = ResizePlan::new(&bench.device, square(SIDE), square(to))?;
    let mut scratch = plan.scratch(&bench.device, FRAMES)?;
    let mut small = bench.device.buffer("small", FRAMES * to * to * 4)?;
    let work = Work::Bytes((16 * FRAMES * (SIDE * SIDE + to * to)) as f64, "16·F·(H·W + H'·W')");
    bench.passes(&format!("image/resize forward {FRAMES}x{SIDE}x{SIDE}->{to}"), work, |rec| {
        resize::forward(rec, &plan, &clips.x, &mut small, &mut scratch)
    })?;
    // As a step has it: through the clamp before it.
    let work = Work::Bytes((16 * FRAMES * (2 * SIDE * SIDE + to * to)) as f64, "16·F·(2·H·W + H'·W')");
    bench.passes(&format!("image/resize backward {FRAMES}x{SIDE}x{SIDE}->{to}, clamped"), work, |rec| {
        let onward = Onward { clamped: Some(&clips.x), ..Onward::default() };
        resize::backward(rec, &plan, &small, &mut clips.out, onward, &mut scratch)
    })
}

/// Work of a pass over whole clips: two that it reads or writes, or three.
fn two() -> Work {
    Work::Bytes((2 * 16 * PIXELS) as f64, "2·16·F·H·W")
}

fn three() -> Work {
    Work::Bytes((3 * 16 * PIXELS) as f64, "3·16·F·H·W")
}

fn map_pixels(bench: &mut Bench, clips: &mut Clips) -> Outcome {
    let Clips { x, v_y, out } = clips;
    let label = format!("{FRAMES}x{SIDE}x{SIDE}");
    // Its backward pass is the same kernel with the transposed map.
    let map = [[0.5, 0.25, 0.25], [0.25, 0.5, 0.25], [0.25, 0.25, 0.5]];
    bench.passes(&format!("image/colour_map {label}"), two(), |rec| colour_map::forward(rec, &map, x, out))?;
    let by = Normalization { mean: [0.5; 3], std: [0.25; 3] };
    bench.passes(&format!("image/normalize forward {label}"), two(), |rec| normalize::forward(rec, &by, x, out))?;
    bench.passes(&format!("image/normalize backward {label}"), two(), |rec| normalize::backward(rec, &by, v_y, out))
}

/// Whole frames in the cells of four pixels that `AlexNet`'s first layer strides over.
fn cut_out(bench: &mut Bench, clips: &mut Clips) -> Outcome {
    let (patch, padding) = (4, 2);
    let full = ImageSize { height: SIDE, width: SIDE };
    let cells = Cells { grid: [SIDE / patch + 1; 2], patch, padding };
    let crop = Crop { window: Window { frame: 0, frames: FRAMES, corner: [0; 2], size: full, full }, cells };
    let by = Normalization { mean: [0.5; 3], std: [0.25; 3] };
    let mut y = bench.device.buffer("y", cells.len(FRAMES))?;
    let label = format!("{FRAMES}x{SIDE}x{SIDE}, patch {patch}");
    bench.passes(&format!("image/crop forward {label}"), two(), |rec| {
        crop::forward(rec, &crop, &by, &clips.x, &mut y, 0)
    })?;
    bench.passes(&format!("image/crop backward {label}"), three(), |rec| {
        crop::backward(rec, &crop, &by, &y, &mut clips.out)
    })
}

fn disturb_pixels(bench: &mut Bench, clips: &mut Clips) -> Outcome {
    let Clips { x, v_y, out } = clips;
    let label = format!("{FRAMES}x{SIDE}x{SIDE}");
    bench.passes(&format!("image/quantize {label}"), two(), |rec| quantize::forward(rec, x, out))?;
    let mut words = bench.device.buffer("words", PIXELS)?;
    let packed = || Work::Bytes((20 * PIXELS) as f64, "(16 + 4)·F·H·W");
    bench.passes(&format!("image/levels pack {label}"), packed(), |rec| levels::pack(rec, x, &mut words))?;
    bench.passes(&format!("image/levels unpack {label}"), packed(), |rec| levels::unpack(rec, &words, out))?;
    let noise = Noise { sigma: 0.02, seed: 1, stream: 0 };
    bench.passes(&format!("image/noise forward {label}"), two(), |rec| noise::forward(rec, &noise, x, out))?;
    bench.passes(&format!("image/noise backward {label}"), three(), |rec| noise::backward(rec, &noise, x, v_y, out))
}

fn distort(bench: &mut Bench, clips: &mut Clips) -> Outcome {
    let Clips { x, v_y, out } = clips;
    let label = format!("{FRAMES}x{SIDE}x{SIDE}");
    let clip = ClipShape { frames: FRAMES, height: SIDE, width: SIDE };
    let turn = Warp::rotation(clip, 15.0, Sampling::Bilinear, [0.0; 3]);
    bench.passes(&format!("image/warp forward {label}, 15 degrees"), two(), |rec| {
        warp::forward(rec, clip, &turn, x, out)
    })?;
    bench.passes(&format!("image/warp backward {label}, 15 degrees"), two(), |rec| {
        warp::backward(rec, clip, &turn, v_y, out)
    })?;
    let quality = JpegQuality::new(&bench.device, 50)?;
    bench.passes(&format!("image/jpeg forward {label}"), two(), |rec| jpeg::forward(rec, clip, &quality, x, out))?;
    bench.passes(&format!("image/chroma420 {label}"), two(), |rec| chroma420::forward(rec, clip, x, out))
}
