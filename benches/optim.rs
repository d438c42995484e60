//! Adam on as many offsets as a small scene has, and the smoothing of their gradient.

use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState};
use guard4d_kernels::optim::neighbour_mean::{self, Neighbourhood};
use guard4d_kernels::shape::dim;

use crate::Outcome;
use crate::harness::{Bench, Work};

const PARAMETERS: usize = 1_700_000;
/// Elements of a row and neighbours of each, as an embedding with DC offsets has them.
const ROW: usize = 4;
const NEIGHBOURS: usize = 8;
/// Distance of neighbours in memory, so that they are not beside each other there either.
const STRIDE: usize = 10_007;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    let v_param = bench.data("v_param", PARAMETERS)?;
    let mut param = bench.data("param", PARAMETERS)?;
    let mut state = AdamState::new(&bench.device, "param", PARAMETERS)?;
    let work = Work::Bytes(28.0 * PARAMETERS as f64, "7·4·n");
    bench.passes("optim/adam 1.7 M parameters", work, |rec| {
        adam::step(rec, &mut param, &v_param, &mut state, &AdamConfig::default())
    })?;
    let rows = PARAMETERS / ROW;
    let near: Vec<_> =
        (0..rows * NEIGHBOURS).map(|at| dim((at / NEIGHBOURS + (1 + at % NEIGHBOURS) * STRIDE) % rows)).collect();
    let neighbours = bench.device.buffer_from("neighbours", &near)?;
    let near = Neighbourhood { neighbours: &neighbours, row: ROW, share: 0.5 };
    let bytes = 4 * (2 * ROW + NEIGHBOURS + NEIGHBOURS * ROW) * rows;
    bench.passes("optim/neighbour_mean 425 k rows, 8 each", Work::Bytes(bytes as f64, "4·(2·r+K+K·r)·N"), |rec| {
        neighbour_mean::mix(rec, &v_param, &near, &mut param)
    })
}
