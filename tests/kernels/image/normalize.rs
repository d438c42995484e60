//! image/normalize: twin against differences, GPU against the twin.

use guard4d_kernels::image::normalize::{Normalization, backward, forward};
use guard4d_kernels::reference::image::normalize as twin;

use super::{dot, follows_the_twin};
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

const BY: Normalization = Normalization { mean: [0.5, 0.4, 0.3], std: [0.2, 0.3, 0.4] };

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    let (x, v_y) = (random.vec(20, 0.0, 1.0), random.vec(20, -1.0, 1.0));
    let (mean, std) = (BY.mean.map(f64::from), BY.std.map(f64::from));
    let worst = gradcheck(|x| dot(&twin::forward(mean, std, x), &v_y), &x, &twin::backward(std, &v_y));
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn gpu_follows_the_twin_poison_included() {
    // One subtraction and one division. Poison reaches itself alone.
    follows_the_twin(
        (1e-6, 1e-6),
        1,
        |rec, [x, v_y], [y, v_x]| {
            forward(rec, &BY, x, y)?;
            backward(rec, &BY, v_y, v_x)
        },
        |x, v_y| [twin::forward(BY.mean, BY.std, x), twin::backward(BY.std, v_y)],
    );
}
