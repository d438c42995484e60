mod bce;
mod lpips;
mod offset_penalty;
mod pixel;
mod ssim;
mod sum;

use guard4d_kernels::Buffer;
use guard4d_kernels::loss::Term;
use guard4d_kernels::shape::Accumulate;

use super::nn::{run, unwritten, upload};

/// A weighted term into slot 1.
fn term(values: &mut Buffer<f32>, weight: f32, accumulate: Accumulate) -> Term<'_> {
    Term { values, slot: 1, weight, accumulate }
}
