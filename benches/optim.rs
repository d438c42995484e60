//! Adam on as many offsets as a small scene has.

use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState};

use crate::Outcome;
use crate::harness::{Bench, Work};

const PARAMETERS: usize = 1_700_000;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let v_param = bench.data("v_param", PARAMETERS)?;
    let mut param = bench.data("param", PARAMETERS)?;
    let mut state = AdamState::new(&bench.device, "param", PARAMETERS)?;
    let work = Work::Bytes(28.0 * PARAMETERS as f64, "7·4·n");
    bench.passes("optim/adam 1.7 M parameters", work, |rec| {
        adam::step(rec, &mut param, &v_param, &mut state, &AdamConfig::default())
    })
}
