//! What the device can do at best: the denominators of every share in the report.

use guard4d_kernels::nn::axpy;
use guard4d_kernels::probe::mul_add::{Chains, run};

use crate::Outcome;
use crate::harness::{Bench, Work};

/// Rows that measure arithmetic, and those that measure memory.
pub(crate) const ARITHMETIC: &str = "probe/mul_add";
pub(crate) const MEMORY: &str = "probe/memory";

/// Invocations of the arithmetic probe.
const LANES: usize = 1 << 16;
/// Elements of the memory probes: 64 MiB, more than a cache holds.
const LARGE: usize = 1 << 24;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    // The chains approach 1, so that no value becomes slow to compute with.
    let chains = Chains { runs: 64, scale: 0.999, shift: 0.001 };
    let (x, mut y) = (bench.data("x", LANES)?, bench.device.buffer("y", LANES)?);
    let work = Work::Flops(chains.flops(LANES), "2·12 chains·32·runs·n");
    bench.passes(&format!("{ARITHMETIC} {LANES} x {} runs", chains.runs), work, |rec| run(rec, chains, &x, &mut y))?;

    let (x, d, mut y) = (bench.data("x", LARGE)?, bench.data("d", LARGE)?, bench.device.buffer("y", LARGE)?);
    let mega = LARGE >> 20;
    bench.passes(&format!("{MEMORY} copy {mega} Mi floats"), Work::Bytes(8.0 * LARGE as f64, "2·4·n"), |rec| {
        rec.copy(&x, 0, &mut y, 0, LARGE)
    })?;
    bench.passes(&format!("{MEMORY} x + s d {mega} Mi floats"), Work::Bytes(12.0 * LARGE as f64, "3·4·n"), |rec| {
        axpy::forward(rec, 0.5, &x, &d, &mut y)
    })
}
