//! Losses, each with its gradient.

use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::loss::bce::{self, Groups, Objective};
use guard4d_kernels::loss::pixel::{self, PixelWeights};
use guard4d_kernels::loss::ssim::{self, SsimPair, SsimReference, SsimScratch};
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::loss::{PixelPair, Term};
use guard4d_kernels::shape::Accumulate;

use crate::Outcome;
use crate::harness::{Bench, Work};

const FRAMES: usize = 8;
const SIDE: usize = 400;
const PIXELS: usize = FRAMES * SIDE * SIDE;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let size = ImageSize { height: SIDE, width: SIDE };
    let clip = bench.data("clip", 4 * PIXELS)?;
    let reference = bench.device.buffer("reference", 4 * PIXELS)?;
    let weights = PixelWeights { square: 1.0, absolute: 1.0 };
    let mut v_clip = bench.device.buffer("v_clip", 4 * PIXELS)?;
    let mut values = bench.device.buffer("values", pixel::VALUES)?;
    let mut sums = SumScratch::new(&bench.device, PIXELS)?;
    let label = format!("{FRAMES}x{SIDE}x{SIDE}");
    let accumulate = Accumulate::Overwrite;
    bench.passes(&format!("loss/pixel {label}"), Work::Bytes((48 * PIXELS) as f64, "3·16·F·H·W"), |rec| {
        let pair = PixelPair { image: &clip, image_px: 0, reference: &reference, reference_px: 0, num_px: PIXELS };
        let term = Term { values: &mut values, slot: 0, weight: 1.0, accumulate };
        pixel::step(rec, (&pair, weights), &mut v_clip, term, &mut sums)
    })?;

    let mut scratch = SsimScratch::new(&bench.device, size, FRAMES)?;
    let mut moments = SsimReference::new(&bench.device, size, FRAMES)?;
    let mut rec = bench.device.recorder()?;
    ssim::prepare(&mut rec, &reference, &mut moments, &mut scratch)?;
    rec.submit()?;
    let pair = SsimPair { clip: &clip, reference: &reference, moments: &moments };
    let work = Work::Bytes((80 * PIXELS) as f64, "5·16·F·H·W");
    bench.passes(&format!("loss/ssim {label}"), work, |rec| {
        let term = Term { values: &mut values, slot: 0, weight: 1.0, accumulate };
        ssim::step(rec, &pair, &mut v_clip, term, &mut scratch)
    })?;

    let groups = Groups { groups: 3, rows: FRAMES, bits: 48 };
    let elements = groups.groups * groups.rows * groups.bits;
    let (logits, target) = (bench.data("logits", elements)?, bench.data("target", groups.bits)?);
    let mut v_logits = bench.device.buffer("v_logits", elements)?;
    let mut value = bench.device.buffer("value", groups.groups)?;
    let work = Work::Bytes((12 * elements) as f64, "3·4·groups·rows·bits");
    bench.passes("loss/bce forward and backward 3x8 rows of 48 bits", work, |rec| {
        bce::forward(rec, Objective::Bce, groups, (&logits, &target), &mut value)?;
        bce::backward(rec, (Objective::Bce, 1.0), groups, (&logits, &target, &value), &mut v_logits)
    })
}
