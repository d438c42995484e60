//! Antialiased resize of a clip to CLIP's input.

use guard4d_kernels::image::resize::{self, ImageSize, ResizePlan};
use guard4d_kernels::shape::Accumulate;

use crate::Outcome;
use crate::harness::{Bench, Work};

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let (frames, from, to) = (8, 400, 64);
    let square = |side| ImageSize { height: side, width: side };
    let plan = ResizePlan::new(&bench.device, square(from), square(to))?;
    let mut scratch = plan.scratch(&bench.device, frames)?;
    let mut large = bench.data("large", frames * from * from * 4)?;
    let mut small = bench.device.buffer("small", frames * to * to * 4)?;
    let work = Work::Bytes((16 * frames * (from * from + to * to)) as f64, "16·F·(H·W + H'·W')");
    bench.passes(&format!("image/resize forward {frames}x{from}x{from}->{to}"), work, |rec| {
        resize::forward(rec, &plan, &large, &mut small, &mut scratch)
    })?;
    bench.passes(&format!("image/resize backward {frames}x{from}x{from}->{to}"), work, |rec| {
        resize::backward(rec, &plan, &small, (&mut large, Accumulate::Overwrite), &mut scratch)
    })
}
