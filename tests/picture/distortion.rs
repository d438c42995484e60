//! Distortions: how they are written, their true strengths, their gradients.

use guard4d_engine::media::Frame;
use guard4d_engine::picture::distortion::{Distortion, DistortionChain, DistortionKind, DistortionLayer, Drawn};
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, KernelError, Recorder};

use crate::support::close::largest;
use crate::support::gpu::{Gpu, device};
use crate::support::random::Random;

const CLIP: ClipShape = ClipShape { frames: 2, height: 24, width: 20 };
/// One of each kind, none so strong that a colour between 0.3 and 0.7 leaves [0, 1].
const ALL: [&str; 10] = [
    "identity",
    "noise:0.02",
    "rotation:-7.5",
    "rescale:0.5",
    "blur:1.2",
    "crop:0.7",
    "mirror",
    "brightness:1.3",
    "jpeg:80",
    "codec:1",
];

fn parsed(text: &str) -> Distortion {
    text.parse().expect("well written")
}

fn colours(random: &mut Random, low: f32, high: f32) -> Vec<f32> {
    let floats = random.vec_f32(CLIP.pixels() * 4, low, high);
    floats.iter().enumerate().map(|(i, v)| if i % 4 < 3 { *v } else { 0.0 }).collect()
}

fn run(gpu: &Gpu, record: impl FnOnce(&mut Recorder) -> Result<(), KernelError>) {
    let mut rec = gpu.recorder().expect("recorder");
    record(&mut rec).expect("records");
    rec.submit().expect("runs");
}

#[test]
fn what_is_printed_can_be_read_again_and_nonsense_is_refused() {
    for text in ALL.iter().chain(&["rotation:-15..15", "brightness:0.7..1.3"]) {
        assert_eq!(parsed(text).to_string(), *text);
    }
    assert_eq!(parsed("rotation:-15..15").strength(0.75).to_bits(), 7.5_f64.to_bits(), "three quarters of the way");
    for (text, why) in [
        ("", "NAME one of identity, noise"),
        ("jpeg", "NAME:STRENGTH"),
        ("identity:1", "NAME:STRENGTH"),
        ("mirror:1", "NAME:STRENGTH"),
        ("gamma:2", "NAME one of"),
        ("noise:loud", "NAME:STRENGTH"),
        ("noise:NaN", "from 0 to 1"),
        ("noise:1.5", "from 0 to 1"),
        ("jpeg:0", "from 1 to 100"),
        ("jpeg:50.5", "whole quality"),
        ("crop:0", "from 0.05 to 1"),
        ("rotation:15..-15", "from -180 to 180"),
        ("blur:1..2", "with one strength"),
    ] {
        let refused = text.parse::<Distortion>().expect_err(text).to_string();
        assert!(refused.contains(why), "{text}: {refused}");
    }
    assert!(Distortion::new(DistortionKind::Crop, f64::INFINITY).is_err(), "no number");
}

/// Two clips apart by `delta`, distorted; and the gradient that comes back for `v_y`.
fn both(gpu: &Gpu, distortion: &str, [x, delta, v_y]: [&[f32]; 3]) -> [Vec<f32>; 3] {
    let mut layer = DistortionLayer::new(gpu, CLIP, &[parsed("identity"), parsed(distortion)]).expect("layer");
    let drawn = Drawn { index: 1, share: 0.5, seed: 4, stream: 2 };
    let moved: Vec<f32> = x.iter().zip(delta).map(|(x, d)| x + d).collect();
    let [x, moved, v_y] = [x, &moved, v_y].map(|data| gpu.buffer_from("input", data).expect("buffer"));
    let mut out: [Buffer<f32>; 3] =
        std::array::from_fn(|_| gpu.buffer_from("output", &vec![f32::NAN; x.len()]).expect("buffer"));
    let [plain, other, v_x] = &mut out;
    run(gpu, |rec| {
        layer.forward(rec, drawn, &x, plain)?;
        layer.forward(rec, drawn, &moved, other)?;
        layer.backward(rec, drawn, &x, &v_y, v_x)
    });
    out.map(|buffer| buffer.read().expect("read"))
}

/// Σ a b over colours.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let products = a.iter().zip(b).enumerate().filter(|(i, _)| i % 4 < 3);
    products.map(|(_, (a, b))| f64::from(*a) * f64::from(*b)).sum()
}

#[test]
fn gradients_are_the_adjoint_of_what_a_change_becomes() {
    let Some(gpu) = device() else { return };
    for text in ALL {
        let mut random = Random(5);
        let x = colours(&mut random, 0.35, 0.65);
        let delta = colours(&mut random, -0.05, 0.05);
        let v_y = colours(&mut random, -1.0, 1.0);
        let [plain, other, v_x] = both(&gpu, text, [&x, &delta, &v_y]);
        let change: Vec<f32> = other.iter().zip(&plain).map(|(a, b)| a - b).collect();
        let (seen, predicted) = (dot(&change, &v_y), dot(&delta, &v_x));
        // All but JPEG are linear where nothing is clamped: 960 products, whose factors differ by roundings of 6e-8.
        // JPEG rounds each coefficient by up to half a step, 1 to 20 levels at quality 80, which is noise to the
        // estimate.
        let size = dot(&delta, &delta).sqrt() * dot(&v_y, &v_y).sqrt();
        let bound = if text.starts_with("jpeg") { 0.1 } else { 1e-5 };
        assert!((seen - predicted).abs() < bound * size, "{text}: {seen} seen, {predicted} predicted, of {size}");
        assert!(dot(&v_x, &v_x) > 0.0, "{text}: a gradient comes back");
    }
}

#[test]
fn strengths_are_what_their_names_say() {
    let Some(gpu) = device() else { return };
    let grey: Vec<f32> = (0..CLIP.pixels() * 4).map(|i| if i % 4 < 3 { 0.5 } else { 0.0 }).collect();
    let of = |text: &str, x: &[f32]| {
        let zeros = vec![0.0; x.len()];
        let [y, ..] = both(&gpu, text, [x, &zeros, &zeros]);
        y
    };
    let deviation = |y: &[f32]| (dot(y, y) / (CLIP.pixels() * 3) as f64 - 0.25).abs();
    // 2880 samples: the variance's standard error is a 38th of it, and the mean's shift of the square 0.02/54; five of
    // each.
    let noisy = of("noise:0.02", &grey);
    let off: Vec<f32> = noisy.iter().map(|v| v - 0.5).collect();
    let sigma = (dot(&off, &off) / (CLIP.pixels() * 3) as f64).sqrt();
    assert!((sigma - 0.02).abs() < 0.02 * 5.0 / 76.0, "noise of {sigma}");
    // Grey stays grey but for its brightness, and for the black around what is turned.
    for text in ["rescale:0.5", "blur:1.2", "crop:0.7", "codec:2"] {
        // Weights that add up to 1 within roundings.
        assert!(deviation(&of(text, &grey)) < 1e-5, "{text}: {}", deviation(&of(text, &grey)));
    }
    let bright = of("brightness:1.3", &grey);
    assert!((dot(&bright, &bright) / (CLIP.pixels() * 3) as f64 - 0.4225).abs() < 1e-5, "0.65 squared");
    // A turn by 45 degrees leaves the corners black, by 180 degrees nothing.
    let corner = |y: &[f32]| y[0];
    assert!(corner(&of("rotation:45", &grey)).abs() < 1e-6, "outside is black");
    assert!((corner(&of("rotation:180", &grey)) - 0.5).abs() < 1e-4, "half a turn shows all of the picture");
}

#[test]
fn an_attack_rounds_each_distortion_and_refuses_ranges_and_other_sizes() {
    let Some(gpu) = device() else { return };
    let rgb: Vec<u8> = (0..8 * 6 * 3).map(|i| (i * 7 % 256) as u8).collect();
    let frame = Frame::new(8, 6, rgb.clone()).expect("a frame");
    let mut nothing = DistortionChain::new(&gpu, (8, 6), &[parsed("identity")], 0).expect("prepares");
    assert_eq!(nothing.apply(&frame, 0).expect("runs"), frame, "eight bits stay eight bits");
    let mut swapped = DistortionChain::new(&gpu, (8, 6), &[parsed("mirror")], 0).expect("prepares");
    let mirrored = swapped.apply(&frame, 0).expect("runs");
    let rows = mirrored.rgb().chunks_exact(24).zip(rgb.chunks_exact(24));
    for (y, (got, want)) in rows.enumerate() {
        assert!(got.chunks_exact(3).rev().eq(want.chunks_exact(3)), "row {y} from right to left");
    }
    let mut chain =
        DistortionChain::new(&gpu, (8, 6), &[parsed("brightness:0.5"), parsed("brightness:2")], 0).expect("prepares");
    let halved = |v: u8| (f32::from(v) * 0.5 / 255.0 * 255.0 + 0.5).floor();
    let want: Vec<f32> = rgb.iter().map(|v| (halved(*v) * 2.0).min(255.0)).collect();
    let got = chain.apply(&frame, 0).expect("runs");
    // Halves may be rounded either way: two levels after they are doubled.
    let off = largest(got.rgb().iter().zip(&want).map(|(g, w)| (f32::from(*g) - w).abs()));
    assert!(off <= 2.0, "darkened, rounded, brightened: {off} levels off");
    let odd = got.rgb().iter().filter(|v| **v % 2 == 1).count();
    assert!(odd <= rgb.iter().filter(|v| **v == 255).count(), "the first rounding shows: {odd} odd levels");
    let mut noise = DistortionChain::new(&gpu, (8, 6), &[parsed("noise:0.1")], 3).expect("prepares");
    let (first, second) = (noise.apply(&frame, 0).expect("runs"), noise.apply(&frame, 1).expect("runs"));
    assert!(first != second, "another frame, another noise");
    assert_eq!(noise.apply(&frame, 0).expect("runs"), first, "the same noise again");

    let refused = DistortionChain::new(&gpu, (8, 6), &[parsed("crop:0.5..0.9")], 0).expect_err("a range").to_string();
    assert!(refused.contains("crop:0.5..0.9") && refused.contains("one strength"), "{refused}");
    let other = Frame::new(6, 8, rgb).expect("a frame");
    let refused = noise.apply(&other, 5).expect_err("another size").to_string();
    assert!(refused.contains("frame 5") && refused.contains("8 x 6"), "{refused}");
}
