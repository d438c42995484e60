//! Which cooperative matrices are of use, and that precision f16 is refused where there are none.

use guard4d_engine::error::EngineError;
use guard4d_kernels::nn::matmul::{Product, forward};
use guard4d_kernels::nn::pack::{PackedWeight, Precision};
use guard4d_kernels::vk::Cooperation;

use crate::support::gpu::device;

#[test]
fn subgroups_share_a_tile_in_blocks_as_square_as_can_be() {
    // Four matrices down and across for 4, 2 and 16 subgroups; eight down for 16 subgroups of eight lanes.
    for (shape, subgroup_size, want) in
        [([16, 16, 16], 32, (4, 2)), ([16, 16, 16], 64, (2, 1)), ([8, 8, 8], 8, (16, 4)), ([8, 16, 16], 16, (8, 2))]
    {
        let got = Cooperation::new(shape, subgroup_size).expect("it fits");
        let [m, n, k] = shape;
        assert_eq!((got.m, got.n, got.k), (m, n, k), "the shape is kept");
        assert_eq!((got.subgroups, got.row_blocks), want, "{shape:?} by subgroups of {subgroup_size}");
        let (down, across) = (64 / m / got.row_blocks, 64 / n / (got.subgroups / got.row_blocks));
        assert_eq!(down * m * across * n * got.subgroups, 64 * 64, "no element is left out or done twice");
    }
}

#[test]
fn what_does_not_divide_a_tile_is_of_no_use() {
    for (shape, subgroup_size) in [
        ([24, 16, 16], 32),
        ([16, 24, 16], 32),
        ([16, 16, 24], 32),
        ([16, 2, 16], 32),
        ([16, 16, 64], 32),
        ([16, 16, 16], 48),
        ([16, 16, 16], 256),
        ([0, 16, 16], 32),
        ([16, 16, 16], 0),
        // Results of 16 subgroups at a time are more than the shader keeps.
        ([16, 16, 16], 8),
    ] {
        assert_eq!(Cooperation::new(shape, subgroup_size), None, "{shape:?} by subgroups of {subgroup_size}");
    }
}

#[test]
fn half_precision_is_there_or_refused() {
    let Some(gpu) = device() else { return };
    let weight = PackedWeight::in_precision(&gpu, "w", &[1.0; 64], 8, 8, Precision::Half);
    if gpu.info().cooperation.is_some() {
        let a = gpu.buffer_from("a", &[1.0; 24]).expect("buffer");
        let mut c = gpu.buffer("c", 24).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        forward(&mut rec, &Product::plain(&a, 3, &weight.expect("packs")), &mut c).expect("records");
        rec.submit().expect("runs");
        assert_eq!(c.read().expect("read"), [8.0; 24], "small whole numbers are exact in f16 too");
        return;
    }
    let refused = EngineError::from(weight.expect_err("no means for it"));
    // docs/reference/exit-codes.md
    assert_eq!(refused.exit_code(), 69);
    assert!(refused.to_string().contains("VK_KHR_cooperative_matrix"), "{refused}");
}

#[test]
fn precisions_are_read_back_from_their_names() {
    for precision in [Precision::F32, Precision::Fixed16, Precision::Half] {
        assert_eq!(precision.to_string().parse(), Ok(precision), "{precision}");
    }
    assert!("f8".parse::<Precision>().is_err(), "nothing else is a name");
}
