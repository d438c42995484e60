//! image/colour_map: twin against differences, GPU against the twin.

use guard4d_kernels::image::colour_map::{ColourMap, backward, forward};
use guard4d_kernels::reference::image::colour_map as twin;

use super::{dot, follows_the_twin};
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

/// Not symmetric, so that a forgotten transposition shows.
const MAP: ColourMap = [[0.5, -0.25, 2.0], [1.5, 0.125, -1.0], [-0.75, 3.0, 0.25]];

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    let (x, v_y) = (random.vec(20, 0.0, 1.0), random.vec(20, -1.0, 1.0));
    let map = MAP.map(|row| row.map(f64::from));
    let worst = gradcheck(|x| dot(&twin::forward(map, x), &v_y), &x, &twin::backward(map, &v_y));
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn gpu_follows_the_twin_poison_included() {
    // Three products of numbers up to 3, summed. Poison reaches every colour of its pixel.
    follows_the_twin(
        (2e-6, 1e-6),
        3,
        |rec, [x, v_y], [y, v_x]| {
            forward(rec, &MAP, x, y)?;
            backward(rec, &MAP, v_y, v_x)
        },
        |x, v_y| [twin::forward(MAP, x), twin::backward(MAP, v_y)],
    );
}
