//! image/jpeg: the quality scale, twin and GPU against libjpeg, GPU against the twin, the straight-through gradient.

use guard4d_kernels::image::chroma420::{JFIF, inverse};
use guard4d_kernels::image::jpeg::{JpegQuality, backward, forward, steps};
use guard4d_kernels::reference::image::jpeg as twin;
use guard4d_kernels::shape::ClipShape;

use super::{both_ways, dot, run, unwritten, upload};
use crate::support::close::{assert_close, largest};
use crate::support::golden::Golden;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

fn maps() -> [[[f64; 3]; 3]; 2] {
    [JFIF, inverse(&JFIF)].map(|m| m.map(|row| row.map(f64::from)))
}

fn on_gpu(gpu: &Gpu, clip: ClipShape, quality: u8, x: &[f32]) -> Vec<f32> {
    let quality = JpegQuality::new(gpu, quality).expect("steps");
    let (x, mut y) = (upload(gpu, x), unwritten(gpu, x.len()));
    run(gpu, |rec| forward(rec, clip, &quality, &x, &mut y));
    y.read().expect("read")
}

/// `[n,3]` with a fourth channel of zeros.
fn with_fourth(rgb: &[f32]) -> Vec<f32> {
    rgb.chunks_exact(3).flat_map(|c| [c[0], c[1], c[2], 0.0]).collect()
}

/// Root of the mean squared difference of colours, in 8-bit levels.
fn rms(a: &[f32], b: &[f32]) -> f32 {
    let squares: f32 = a.iter().zip(b).map(|(a, b)| (a.clamp(0.0, 1.0) - b).powi(2)).sum();
    255.0 * (squares / (a.len() as f32 * 0.75)).sqrt()
}

#[test]
fn steps_scale_as_in_libjpeg() {
    let sample = |quality: u8| {
        let steps = steps(quality);
        [steps[0], steps[63], steps[64], steps[127]]
    };
    // Quality 50 is the standard's tables; 10 is five times as coarse and stops at 255; 100 does not round at all but
    // to 1.
    assert_eq!(sample(50), [16.0, 99.0, 17.0, 99.0]);
    assert_eq!(sample(10), [80.0, 255.0, 85.0, 255.0]);
    assert_eq!(sample(75), [8.0, 50.0, 9.0, 50.0]);
    assert!(steps(100).iter().all(|s| s.to_bits() == 1.0_f32.to_bits()), "{:?}", steps(100));
}

#[test]
fn pictures_are_what_libjpeg_makes_of_them() {
    let golden = Golden::load("jpeg");
    let luma = |x: &[f32]| -> Vec<f32> {
        let dot = |p: &[f32]| JFIF[0].iter().zip(p).map(|(m, v)| m * v.clamp(0.0, 1.0)).sum::<f32>();
        x.chunks_exact(4).flat_map(|p| [dot(p), dot(p), dot(p), 0.0]).collect()
    };
    for name in ["grey", "colour"] {
        let shape = golden.shape(&format!("{name}.x"));
        let clip = ClipShape { frames: 1, height: shape[0], width: shape[1] };
        let x = with_fourth(&golden.f32(&format!("{name}.x")));
        for quality in [10u8, 50, 90] {
            let want = with_fourth(&golden.f32(&format!("{name}.y{quality}")));
            let lost = rms(&want, &x);
            assert!(lost > 0.3, "{name} at quality {quality}: the picture hardly changes, {lost} levels");
            let Some(gpu) = device() else { continue };
            let got = on_gpu(&gpu, clip, quality, &x);
            // libjpeg computes with whole numbers and rounds twice, up to half a level each time; and what it clips
            // where this does not, because it interpolates chroma that this repeats, shows in the luma of strong
            // colours.
            let off = rms(&luma(&got), &luma(&want));
            assert!(off < 1.5, "{name} at quality {quality}: luma is {off} levels from libjpeg's");
            // That interpolation is a part of what the file loses in colour, and nothing of it in a grey picture.
            let off = rms(&got, &want);
            let bound = if name == "grey" { 0.8 } else { (0.5 * lost).max(1.5) };
            assert!(off < bound, "{name} at quality {quality}: {off} levels from libjpeg's, which loses {lost}");
        }
    }
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (frames, height, width, quality, seed) in [(1, 1, 1, 50, 1), (2, 9, 18, 10, 2), (1, 17, 34, 50, 3)] {
        let clip = ClipShape { frames, height, width };
        let x = Random(seed).vec_f32(clip.pixels() * 4, 0.0, 1.0);
        let steps: Vec<f64> = steps(quality).into_iter().map(f64::from).collect();
        let wide: Vec<f64> = x.iter().map(|v| f64::from(*v)).collect();
        let (mut want, mut ties) = (Vec::new(), Vec::new());
        for frame in wide.chunks_exact(height * width * 4) {
            let (y, closest) = twin::forward(frame, [height, width], &steps, maps());
            want.extend(y.iter().map(|v| *v as f32));
            ties.push(-closest);
        }
        let tie = -largest(ties);
        // Sums of 64 numbers up to 255 in floats are off by some 1e-4; no coefficient may be rounded the other way for
        // it.
        assert!(tie > 5e-5, "seed {seed}: a coefficient is {tie} steps from a tie; take another seed");
        // Coefficients are whole numbers of steps then, and only the way back rounds: 64 numbers up to 2000 levels.
        assert_close(&on_gpu(&gpu, clip, quality, &x), &want, 2e-5, 0.0);
    }
}

#[test]
fn gradient_passes_the_rounding() {
    let Some(gpu) = device() else { return };
    let clip = ClipShape { frames: 1, height: 6, width: 7 };
    let n = clip.pixels() * 4;
    let mut random = Random(9);
    let (x, v_y) = (random.vec_f32(n, 0.2, 0.8), random.vec_f32(n, -1.0, 1.0));
    let [_, v_x] = both_ways(&gpu, &x, &v_y, |rec, [_, v_y], [_, v_x]| backward(rec, clip, v_y, v_x));
    let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
    let (x, v_y) = (wide(&x), wide(&v_y));
    let grad = twin::backward(&v_y, [6, 7], maps());
    let narrow: Vec<f32> = grad.iter().map(|v| *v as f32).collect();
    // Means of four and two maps with entries below 2.
    assert_close(&v_x, &narrow, 2e-6, 0.0);
    // Without rounding (steps of nearly nothing) the coder is the averaging of chroma, whose derivative this is.
    let weights: Vec<f64> = v_y.iter().enumerate().map(|(i, v)| if i % 4 < 3 { *v } else { 0.0 }).collect();
    let fine = vec![1e-9; 128];
    let worst = gradcheck(|x| dot(&twin::forward(x, [6, 7], &fine, maps()).0, &weights), &x, &grad);
    // Differences of 1e-6 over steps of 1e-9: a thousandth.
    assert!(worst < 1e-3, "{worst}");
}

#[test]
fn poison_stays_in_its_block() {
    let Some(gpu) = device() else { return };
    let clip = ClipShape { frames: 1, height: 32, width: 32 };
    let mut x = Random(3).vec_f32(clip.pixels() * 4, 0.0, 1.0);
    let clean = on_gpu(&gpu, clip, 50, &x);
    let at = (20 * 32 + 20) * 4;
    x[at + 1] = f32::NAN;
    let dirty = on_gpu(&gpu, clip, 50, &x);
    for (i, (dirty, clean)) in dirty.chunks_exact(4).zip(clean.chunks_exact(4)).enumerate() {
        let same_unit = i / 32 / 16 == 1 && i % 32 / 16 == 1;
        assert_eq!(dirty[1].is_nan(), same_unit, "pixel {i}: green depends on all of its unit's chroma");
        assert!(same_unit || dirty == clean, "pixel {i} of another unit changed");
    }
    x[at + 1] = 0.5;
    x[at + 3] = f32::NAN;
    assert!(on_gpu(&gpu, clip, 50, &x).iter().all(|v| v.is_finite()), "no fourth channel is read");
    assert!(on_gpu(&gpu, ClipShape { frames: 0, ..clip }, 50, &[]).is_empty(), "no frame, no pixel");
}
