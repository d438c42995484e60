//! Whether a device's attention in 16-bit floats computes what it should, asked before anything relies on it.

use super::attention::{
    AttentionShape, AttentionState, Mask, ProjectionGrads, Projections, Upstream, backward, forward,
};
use super::pack::Precision;
use crate::error::KernelError;
use crate::vk::Device;

/// Whole tiles and a part of one, two heads.
const SHAPE: AttentionShape = AttentionShape {
    batch: 1,
    heads: 2,
    head_dim: 64,
    queries: 65,
    keys: 65,
    mask: Mask::Full,
    precision: Precision::F32,
};
/// Largest distance from 32-bit floats, of their length. Rounding moves results by 3e-3 at most, as the kernels' tests
/// say; what is wrong is off by a length and more.
const TOLERANCE: f32 = 1e-2;

/// Runs attention forward and backward in both precisions on a small layer, and compares.
///
/// Drivers differ in what they make of cooperative matrices: kernels that were right on Mesa 26 gave gradients that had
/// nothing to do with these on NVIDIA 580, because a shared variable moved the matrices beside it to where they may not
/// be loaded from (the build refuses such kernels since). It takes milliseconds, once for each tower.
///
/// # Errors
/// [`KernelError::Unsuitable`] where the two disagree, and on a device without cooperative matrices.
pub fn check_attention(device: &Device) -> Result<(), KernelError> {
    let floats = attend(device, &SHAPE)?;
    let halves = attend(device, &AttentionShape { precision: Precision::Half, ..SHAPE })?;
    for (what, (half, float)) in ["attention", "gradients of attention"].iter().zip(halves.iter().zip(&floats)) {
        let off = distance(half, float);
        // A NaN is not below the tolerance.
        if !matches!(off.partial_cmp(&TOLERANCE), Some(std::cmp::Ordering::Less)) {
            return Err(KernelError::Unsuitable {
                device: device.info().name.clone(),
                what: format!("right {what} in 16-bit floats (off by {off:.1e} of its length); use --precision f32"),
            });
        }
    }
    Ok(())
}

/// Output and gradients for made inputs between -1 and 1.
fn attend(device: &Device, shape: &AttentionShape) -> Result<[Vec<f32>; 2], KernelError> {
    let made = |len: usize, step: usize| (0..len).map(|i| (i * step % 1009) as f32 / 504.5 - 1.0).collect::<Vec<_>>();
    let tokens = shape.batch * shape.keys * shape.width();
    let qkv = device.buffer_from("qkv", &made(3 * tokens, 7919))?;
    let v_attn = device.buffer_from("v_attn", &made(tokens, 5003))?;
    let (mut attn, mut v_qkv) = (device.buffer("attn", tokens)?, device.buffer("v_qkv", 3 * tokens)?);
    let mut state = AttentionState::new(device, "check", shape)?;
    let inputs = Projections::Fused(&qkv);
    let mut rec = device.recorder()?;
    forward(&mut rec, shape, inputs, &mut state, &mut attn)?;
    let upstream = Upstream { inputs, attn: &attn, v_attn: &v_attn };
    backward(&mut rec, shape, &upstream, &mut state, ProjectionGrads::Fused(&mut v_qkv))?;
    rec.submit()?;
    Ok([attn.read()?, v_qkv.read()?])
}

/// |got − want| / |want|
fn distance(got: &[f32], want: &[f32]) -> f32 {
    let length = |squares: &mut dyn Iterator<Item = f32>| squares.map(|v| v * v).sum::<f32>().sqrt();
    length(&mut got.iter().zip(want).map(|(g, w)| g - w)) / length(&mut want.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::distance;

    #[test]
    fn distances_are_of_the_length_and_keep_a_nan() {
        assert!((distance(&[3.0, 4.5], &[3.0, 4.0]) - 0.1).abs() < 1e-6);
        assert!(distance(&[f32::NAN, 4.0], &[3.0, 4.0]).is_nan());
    }
}
