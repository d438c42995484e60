//! Throughput of multiply and add in registers.

use crate::error::KernelError;
use crate::registry::probe::mul_add_run;
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "probe/mul_add";
/// Chains of one invocation: enough to hide the latency of both operations, few enough for the registers.
pub const CHAINS: usize = 12;
/// Steps of one turn of the shader's loop, where they are written out.
pub const STEPS: u32 = 32;

/// Length and factors of the chains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chains {
    /// Turns of the loop, 1 to 65,535; a chain takes [`STEPS`] steps in each.
    pub runs: u16,
    /// Factor of a step.
    pub scale: f32,
    /// Summand of a step.
    pub shift: f32,
}

impl Chains {
    /// Multiplications and additions in the chains of `n` invocations.
    #[must_use]
    pub fn flops(&self, n: usize) -> f64 {
        2.0 * CHAINS as f64 * f64::from(STEPS) * f64::from(self.runs) * n as f64
    }
}

/// y = Σ_c of the end of the chain v ← v·scale + shift that starts at x + c.
///
/// # Shapes
/// in `x` \[n\] · out `y` \[n\] (=)
/// # Equation: see above; c counts [`CHAINS`] chains
/// # Errors: [`KernelError::Shape`] before anything is recorded
/// # Determinism: bitwise on one driver; whether it fuses multiply and add is the driver's choice
///
/// # Errors
/// See above.
pub fn run(rec: &mut Recorder, chains: Chains, x: &Buffer<f32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    let n = x.len();
    expect_len(KERNEL, "y", y, n)?;
    if chains.runs == 0 {
        let (got, expected) = ("0".to_owned(), "at least one run".to_owned());
        return Err(KernelError::Shape { kernel: KERNEL, buffer: "runs", got, expected });
    }
    let Chains { runs, scale, shift } = chains;
    let params = mul_add_run::Params { n: dim(n), runs: u32::from(runs), scale, shift };
    rec.dispatch(mul_add_run::Bind { x, y }, params, Grid::threads(n))
}
