//! Losses, each with its gradient.

use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::loss::bce::{self, Answers, Groups, Objective};
use guard4d_kernels::loss::lpips::{self, LpipsSums, Tap};
use guard4d_kernels::loss::offset_penalty::{self, Blocks};
use guard4d_kernels::loss::pixel::{self, PixelWeights};
use guard4d_kernels::loss::ssim::{self, SsimPair, SsimReference, SsimScratch};
use guard4d_kernels::loss::sum::{self, SumScratch};
use guard4d_kernels::loss::{PixelPair, Term};
use guard4d_kernels::shape::{Accumulate, OffsetBases};

use crate::harness::{Bench, Outcome, Work};

const FRAMES: usize = 8;
const SIDE: usize = 400;
const PIXELS: usize = FRAMES * SIDE * SIDE;
/// Splats whose offsets are penalised.
const SPLATS: usize = 36_000;
/// Partial sums: as many as a single workgroup is ever given.
const PARTIALS: usize = 1 << 16;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    pictures(bench)?;
    messages(bench)?;
    offsets(bench)?;
    features(bench)?;
    let (partial, mut values) = (bench.data("partial", PARTIALS)?, bench.device.buffer("values", 1)?);
    bench.passes("loss/sum 64 Ki partial sums", Work::Bytes((4 * PARTIALS) as f64, "4·n"), |rec| {
        sum::finish(rec, &partial, 0..PARTIALS, 1.0, &mut values, 0)
    })
}

fn pictures(bench: &mut Bench) -> Outcome {
    let size = ImageSize { height: SIDE, width: SIDE };
    let clip = bench.data("clip", 4 * PIXELS)?;
    let reference = bench.device.buffer("reference", 4 * PIXELS)?;
    let weights = PixelWeights { square: 1.0, absolute: 1.0 };
    let mut v_clip = bench.device.buffer("v_clip", 4 * PIXELS)?;
    let mut values = bench.device.buffer("values", sum::VALUES)?;
    let mut sums = SumScratch::new(&bench.device, PIXELS)?;
    let label = format!("{FRAMES}x{SIDE}x{SIDE}");
    let accumulate = Accumulate::Overwrite;
    bench.passes(&format!("loss/pixel {label}"), Work::Bytes((48 * PIXELS) as f64, "3·16·F·H·W"), |rec| {
        let pair = PixelPair { image: &clip, image_px: 0, reference: &reference, reference_px: 0, num_px: PIXELS };
        let term = Term { values: &mut values, slot: 0, weight: 1.0, accumulate };
        pixel::step(rec, &pair, weights, Some(&mut v_clip), term, &mut sums)
    })?;

    bench.passes(
        &format!("loss/pixel {label}, values only"),
        Work::Bytes((32 * PIXELS) as f64, "2·16·F·H·W"),
        |rec| {
            let pair = PixelPair { image: &clip, image_px: 0, reference: &reference, reference_px: 0, num_px: PIXELS };
            let term = Term { values: &mut values, slot: 0, weight: 0.0, accumulate };
            pixel::step(rec, &pair, weights, None, term, &mut sums)
        },
    )?;

    let mut scratch = SsimScratch::new(&bench.device, size, FRAMES)?;
    let mut moments = SsimReference::new(&bench.device, size, FRAMES)?;
    let work = Work::Bytes((48 * PIXELS) as f64, "3·16·F·H·W");
    bench.passes(&format!("loss/ssim prepare {label}"), work, |rec| {
        ssim::prepare(rec, &reference, &mut moments, &mut scratch)
    })?;
    let pair = SsimPair { clip: &clip, reference: &reference, moments: &moments };
    let work = Work::Bytes((80 * PIXELS) as f64, "5·16·F·H·W");
    bench.passes(&format!("loss/ssim {label}"), work, |rec| {
        let term = Term { values: &mut values, slot: 0, weight: 1.0, accumulate };
        ssim::step(rec, &pair, &mut v_clip, term, &mut scratch)
    })
}

fn messages(bench: &mut Bench) -> Outcome {
    let groups = Groups { groups: 3, rows: FRAMES, bits: 48 };
    let elements = groups.groups * groups.rows * groups.bits;
    let (logits, target) = (bench.data("logits", elements)?, bench.data("target", groups.bits)?);
    let mut v_logits = bench.device.buffer("v_logits", elements)?;
    let mut value = bench.device.buffer("value", groups.groups)?;
    let answers = Answers { groups, logits: &logits, target: &target };
    let work = Work::Bytes((12 * elements) as f64, "3·4·groups·rows·bits");
    bench.passes("loss/bce forward and backward 3x8 rows of 48 bits", work, |rec| {
        bce::forward(rec, Objective::Bce, &answers, &mut value)?;
        bce::backward(rec, Objective::Bce, 1.0, &answers, &value, &mut v_logits)
    })
}

fn offsets(bench: &mut Bench) -> Outcome {
    let blocks = Blocks { bases: OffsetBases::All, degree: 3, dc: 1.0, rest: 1.0 };
    let floats = SPLATS * blocks.bases.floats();
    let offsets = bench.data("offsets", floats)?;
    let mut v_offsets = bench.device.buffer("v_offsets", floats)?;
    let mut values = bench.device.buffer("values", 1)?;
    let mut sums = SumScratch::new(&bench.device, floats / 4)?;
    let work = Work::Bytes((8 * floats) as f64, "2·4·48·N");
    bench.passes(&format!("loss/offset_penalty {SPLATS} splats, all bases"), work, |rec| {
        let term = Term { values: &mut values, slot: 0, weight: 1.0, accumulate: Accumulate::Overwrite };
        offset_penalty::step(rec, &offsets, blocks, &mut v_offsets, term, &mut sums)
    })
}

/// The first tap of `AlexNet` on eight frames of 200 px.
fn features(bench: &mut Bench) -> Outcome {
    let (rows, channels) = (8 * 49 * 49, 64);
    let [features, reference] = [bench.data("features", rows * channels)?, bench.data("reference", rows * channels)?];
    let weight = bench.data("weight", channels)?;
    let mut v_features = bench.device.buffer("v_features", rows * channels)?;
    let mut values = bench.device.buffer("values", 1)?;
    let mut sums = LpipsSums::new(&bench.device, rows)?;
    let work = Work::Bytes((12 * rows * channels) as f64, "3·4·rows·c");
    bench.passes(&format!("loss/lpips {rows}x{channels}"), work, |rec| {
        let tap = Tap { features: &features, reference: &reference, weight: &weight, rows, mean_over: rows };
        let term = Term { values: &mut values, slot: 0, weight: 1.0, accumulate: Accumulate::Overwrite };
        lpips::step(rec, &tap, &mut v_features, term, &mut sums)
    })
}
