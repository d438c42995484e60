//! What the device and one core of the processor can do at best: the denominators of every share in the report.

use std::time::Instant;

use guard4d_kernels::nn::axpy;
use guard4d_kernels::probe::mul_add::{Chains, run};

use crate::harness::{Bench, Outcome, Work};

/// Rows that measure arithmetic, and those that measure memory.
pub(crate) const ARITHMETIC: &str = "probe/mul_add";
pub(crate) const MEMORY: &str = "probe/memory";
/// The row that measures one core.
pub(crate) const HOST: &str = "probe/host fma 256 bit";

/// Invocations of the arithmetic probe.
const LANES: usize = 1 << 16;
/// Elements of the memory probes: 64 MiB, more than a cache holds.
const LARGE: usize = 1 << 24;
/// Rounds of the host probe: some milliseconds.
const ROUNDS: usize = 1 << 22;
/// Sums that the host probe adds to by turns: two units with a latency of five cycles need ten.
const SUMS: usize = 12;
/// Floats of a 256-bit register.
const LANES_256: usize = 8;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    host(bench)?;
    device(bench)
}

/// Fused multiply and add in the 256-bit registers of one core, out of reach of drivers that never fuse.
fn host(bench: &mut Bench) -> Outcome {
    if host_fma(1).is_none() {
        eprintln!("{HOST}: this processor has no AVX2 and FMA, so that there are no shares of this peak");
        return Ok(());
    }
    let work = Work::Flops((2 * SUMS * LANES_256 * ROUNDS) as f64, "2·12 sums·8·rounds");
    bench.samples(HOST, work, || {
        let started = Instant::now();
        host_fma(ROUNDS);
        Ok(started.elapsed())
    })?;
    Ok(())
}

/// Runs the chains and returns their sum, so that none can be left out; `None` without AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
fn host_fma(rounds: usize) -> Option<f32> {
    let simd = pulp::x86::V3::try_new()?;
    Some(simd.vectorize(HostFma { simd, rounds }))
}

#[cfg(not(target_arch = "x86_64"))]
fn host_fma(_: usize) -> Option<f32> {
    None
}

#[cfg(target_arch = "x86_64")]
struct HostFma {
    simd: pulp::x86::V3,
    rounds: usize,
}

#[cfg(target_arch = "x86_64")]
impl pulp::NullaryFnOnce for HostFma {
    type Output = f32;

    #[inline(always)]
    fn call(self) -> f32 {
        use std::hint::black_box;

        let pulp::x86::V3 { avx, fma, .. } = self.simd;
        // The sums approach 1, so that no value becomes slow to compute with.
        let (scale, shift) = (avx._mm256_set1_ps(black_box(0.999)), avx._mm256_set1_ps(black_box(0.001)));
        let mut sums = [shift; SUMS];
        for _ in 0..self.rounds {
            for sum in &mut sums {
                *sum = fma._mm256_fmadd_ps(*sum, scale, shift);
            }
        }
        let total = sums.into_iter().fold(avx._mm256_setzero_ps(), |total, sum| avx._mm256_add_ps(total, sum));
        let lanes: [f32; LANES_256] = pulp::cast(total);
        black_box(lanes.iter().sum())
    }
}

fn device(bench: &mut Bench) -> Outcome {
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
