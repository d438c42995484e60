//! Adam on as many offsets as a small scene has.

use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState, RowRates};
use guard4d_kernels::registry::optim::adam_step_rated;

use crate::harness::{Bench, Outcome, Work};

const PARAMETERS: usize = 1_700_000;
/// Elements that share a rate: the offset of a splat's DC term, padded.
const ROW: usize = 4;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let v_param = bench.data("v_param", PARAMETERS)?;
    let mut param = bench.data("param", PARAMETERS)?;
    let mut state = AdamState::new(&bench.device, "param", PARAMETERS)?;
    let work = Work::Bytes(28.0 * PARAMETERS as f64, "7·4·n");
    bench.passes("optim/adam 1.7 M parameters", work, |rec| {
        adam::step(rec, &mut param, &v_param, &mut state, &AdamConfig::default())
    })?;
    state.rates = Some(RowRates { row: ROW, factors: bench.data("rates", PARAMETERS / ROW)? });
    let rated = "optim/adam 1.7 M parameters, a rate for every 4";
    bench.passes(rated, Work::Bytes(29.0 * PARAMETERS as f64, "7.25·4·n"), |rec| {
        adam::step(rec, &mut param, &v_param, &mut state, &AdamConfig::default())
    })?;
    bench.expect(rated, &[&adam_step_rated::KERNEL])
}
