//! nn/conv3d: twin against differences, GPU against the twin and against PyTorch.

use guard4d_kernels::nn::conv3d::{
    Activation, Bias, Conv3d, Conv3dScratch, InputGradient, Padding, WeightGradient, backward_input, backward_weight,
    forward,
};
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::reference::nn::conv3d as twin;
use guard4d_kernels::shape::{Accumulate, ClipShape};
use guard4d_kernels::{Buffer, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::close::{assert_close, largest};
use crate::support::golden::Golden;
use crate::support::gpu::{Gpu, device, each_family, half_device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

fn layer(shape: [usize; 3], channels: [usize; 2], time: Padding, space: Padding) -> Conv3d {
    Conv3d {
        shape: ClipShape { frames: shape[0], height: shape[1], width: shape[2] },
        in_channels: channels[0],
        out_channels: channels[1],
        time,
        space,
        bias: Bias::None,
        activation: Activation::Identity,
        precision: Precision::F32,
    }
}

fn twin_of(conv: &Conv3d) -> twin::Conv3d {
    let padding = |p| match p {
        Padding::Zero => twin::Padding::Zero,
        Padding::Replicate => twin::Padding::Replicate,
        Padding::Reflect => twin::Padding::Reflect,
    };
    twin::Conv3d {
        shape: [conv.shape.frames, conv.shape.height, conv.shape.width],
        in_channels: conv.in_channels,
        out_channels: conv.out_channels,
        time: padding(conv.time),
        space: padding(conv.space),
    }
}

const PADDINGS: [(Padding, Padding); 3] =
    [(Padding::Zero, Padding::Zero), (Padding::Replicate, Padding::Reflect), (Padding::Reflect, Padding::Replicate)];

#[test]
fn twin_gradients_match_differences() {
    for (time, space) in PADDINGS {
        let conv = twin_of(&layer([2, 3, 2], [2, 2], time, space));
        let mut random = Random(7);
        let x = random.vec(24, -1.0, 1.0);
        let weight = random.vec(108, -1.0, 1.0);
        let bias = random.vec(2, -1.0, 1.0);
        let v_y = random.vec(24, -1.0, 1.0);
        let v_x = conv.backward_input(&v_y, &weight);
        let (v_weight, v_bias) = conv.backward_weight(&x, &v_y);
        // The layer is linear in each argument, so only rounding of the difference remains.
        let worst = gradcheck(|x| dot(&conv.forward(x, &weight, &bias), &v_y), &x, &v_x);
        assert!(worst < 1e-6, "input: {worst}");
        let worst = gradcheck(|w| dot(&conv.forward(&x, w, &bias), &v_y), &weight, &v_weight);
        assert!(worst < 1e-6, "weight: {worst}");
        let worst = gradcheck(|b| dot(&conv.forward(&x, &weight, b), &v_y), &bias, &v_bias);
        assert!(worst < 1e-6, "bias: {worst}");
    }
}

#[test]
fn twin_gradient_passes_the_relu_where_it_is_open() {
    let conv = twin_of(&layer([2, 3, 2], [2, 2], Padding::Zero, Padding::Replicate));
    let mut random = Random(8);
    let (x, weight, bias) = (random.vec(24, -1.0, 1.0), random.vec(108, -1.0, 1.0), random.vec(2, -1.0, 1.0));
    let v_y = random.vec(24, -1.0, 1.0);
    let active = |x: &[f64]| {
        let mut y = conv.forward(x, &weight, &bias);
        twin::relu(&mut y);
        y
    };
    let open = active(&x);
    assert!(open.contains(&0.0) && open.iter().any(|v| *v > 0.0), "some are closed, some open: {open:?}");
    let mut gated = v_y.clone();
    twin::relu_backward(&open, &mut gated);
    // Piecewise linear, and no sum lies within a step of the kink: only rounding of the difference remains.
    let worst = gradcheck(|x| dot(&active(x), &v_y), &x, &conv.backward_input(&gated, &weight));
    assert!(worst < 1e-6, "{worst}");
}

/// One layer with random data on both sides.
struct Case {
    conv: Conv3d,
    x: Vec<f32>,
    weight: Vec<f32>,
    bias: Vec<f32>,
    v_y: Vec<f32>,
}

impl Case {
    fn new(conv: Conv3d) -> Self {
        let pixels = conv.shape.pixels();
        let (ni, no) = (conv.in_channels, conv.out_channels);
        let mut random = Random((pixels * 31 + ni * 7 + no) as u64);
        Self {
            conv,
            x: random.vec_f32(pixels * ni, -1.0, 1.0),
            weight: random.vec_f32(no * ni * 27, -0.2, 0.2),
            bias: random.vec_f32(if conv.bias == Bias::Added { no } else { 0 }, -1.0, 1.0),
            v_y: random.vec_f32(pixels * no, -1.0, 1.0),
        }
    }

    fn packed(&self) -> Vec<f32> {
        let mut packed = self.conv.pack(&self.weight, self.conv.in_channels, self.conv.out_channels);
        let at = packed.len() - self.bias.len();
        packed[at..].copy_from_slice(&self.bias);
        packed
    }

    /// Output and gradients `[y, v_x, v_weight, v_bias]`; the weight gradient is added to `before`.
    fn on_gpu(&self, gpu: &Gpu, gate: Option<&[f32]>, before: f32) -> [Vec<f32>; 4] {
        let conv = &self.conv;
        let x = upload(gpu, &self.x);
        let weight = upload(gpu, &self.packed());
        let v_y = upload(gpu, &self.v_y);
        let gate = gate.map(|gate| upload(gpu, gate));
        let mut y = unwritten(gpu, self.v_y.len());
        let mut v_x = unwritten(gpu, self.x.len());
        let mut v_weight = upload(gpu, &vec![before; conv.weight_len()]);
        let mut scratch = Conv3dScratch::new(gpu, conv).expect("scratch");
        run(gpu, |rec| {
            forward(rec, conv, &x, &weight, &mut y)?;
            let from = InputGradient { v_y: &v_y, weight: &weight, gate: gate.as_ref() };
            backward_input(rec, conv, from, &mut v_x, &mut scratch)?;
            let pass = WeightGradient { x: &x, v_y: &v_y, v_weight: &mut v_weight, accumulate: Accumulate::Add };
            backward_weight(rec, conv, pass, &mut scratch)
        });
        let v_weight: Vec<f32> = v_weight.read().expect("read").iter().map(|v| v - before).collect();
        let v_bias = v_weight[v_weight.len() - self.bias.len()..].to_vec();
        let v_weight = conv.unpack(&v_weight, conv.in_channels, conv.out_channels);
        [y.read().expect("read"), v_x.read().expect("read"), v_weight, v_bias]
    }

    /// The same by the twin.
    fn on_host(&self, gate: &[f32]) -> [Vec<f32>; 4] {
        let reference = twin_of(&self.conv);
        let bias = if self.bias.is_empty() { vec![0.0; self.conv.out_channels] } else { self.bias.clone() };
        let mut y = reference.forward(&self.x, &self.weight, &bias);
        if self.conv.activation == Activation::Relu {
            twin::relu(&mut y);
        }
        let mut v_x = reference.backward_input(&self.v_y, &self.weight);
        twin::relu_backward(gate, &mut v_x);
        let (v_weight, mut v_bias) = reference.backward_weight(&self.x, &self.v_y);
        v_bias.truncate(self.bias.len());
        [y, v_x, v_weight, v_bias]
    }

    /// What cooperative matrices make of it: output and gradient to the input from rounded factors, the rest from
    /// floats.
    fn on_host_rounded(&self, gate: &[f32]) -> [Vec<f32>; 4] {
        let [x, weight, v_y] = [&self.x, &self.weight, &self.v_y].map(|factors| rounded(factors));
        let [y, v_x, ..] = Self { conv: self.conv, bias: self.bias.clone(), x, weight, v_y }.on_host(gate);
        let [.., v_weight, v_bias] = self.on_host(gate);
        [y, v_x, v_weight, v_bias]
    }

    fn check(&self, gpu: &Gpu) {
        let got = self.on_gpu(gpu, Some(&self.x), 1.0);
        let want = self.on_host(&self.x);
        // Up to 864 products of size 0.2 in another order, sums up to 6: a few 2^-24 * 6 * 864^0.5.
        let products = 1e-5;
        // Sums over all pixels, held beside the 1.0 that was there before: its rounding is 6e-8.
        let pixels = 2e-6 * (self.conv.shape.pixels() as f32).sqrt();
        for ((got, want), atol) in got.iter().zip(&want).zip([products, products, pixels, pixels]) {
            assert_close(got, want, atol, 1e-5);
        }
    }
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    // Each row compiles kernels of its own; together they see every padding, tail and block count.
    for (shape, channels, (time, space)) in [
        ([2, 5, 9], [4, 16], PADDINGS[1]),
        ([3, 4, 37], [16, 4], PADDINGS[0]),
        ([2, 2, 2], [8, 8], PADDINGS[2]),
        ([2, 3, 33], [16, 32], PADDINGS[1]),
        ([2, 3, 8], [32, 12], PADDINGS[0]),
        ([1, 17, 34], [4, 8], PADDINGS[1]),
        ([2, 18, 33], [8, 4], PADDINGS[2]),
    ] {
        Case::new(layer(shape, channels, time, space)).check(&gpu);
    }
    let thin = layer([1, 1, 1], [4, 4], Padding::Replicate, Padding::Replicate);
    Case::new(thin).check(&gpu);
    let full = layer([3, 12, 70], [4, 8], Padding::Zero, Padding::Reflect);
    Case::new(Conv3d { bias: Bias::Added, activation: Activation::Relu, ..full }).check(&gpu);
}

/// Factors as cooperative matrices take them.
fn rounded(x: &[f32]) -> Vec<f32> {
    x.iter().map(|v| half::f16::from_f32(*v).to_f32()).collect()
}

/// `conv` in 16-bit floats.
fn halved(conv: Conv3d) -> Conv3d {
    Conv3d { precision: Precision::Half, ..conv }
}

#[test]
fn half_precision_follows_the_twin_on_rounded_operands() {
    let Some(gpu) = half_device() else { return };
    // Tiles of 32 x 8 pixels and 16 channels: full, with a column, a row, a channel or all but one left over; one texel
    // of channels, which is packed by threes; borders that fold onto another tile's side of its edge.
    for (shape, channels, (time, space), bias, activation) in [
        ([2, 5, 9], [4, 16], PADDINGS[1], Bias::None, Activation::Identity),
        ([3, 9, 33], [16, 4], PADDINGS[0], Bias::Added, Activation::Identity),
        ([2, 10, 65], [36, 20], PADDINGS[2], Bias::None, Activation::Identity),
        ([2, 8, 34], [8, 8], PADDINGS[1], Bias::Added, Activation::Relu),
        ([1, 1, 1], [4, 4], (Padding::Replicate, Padding::Replicate), Bias::None, Activation::Identity),
    ] {
        let case = Case::new(Conv3d { bias, activation, ..halved(layer(shape, channels, time, space)) });
        let got = case.on_gpu(&gpu, Some(&case.x), 0.0);
        let want = case.on_host_rounded(&case.x);
        // Products of two f16 are exact in f32. Units that add several at once may drop what lies 2^-22 below the
        // largest partial sum, here about 6, in each of up to 243 steps; errors of both signs leave a third.
        got[..2].iter().zip(&want).for_each(|(got, want)| assert_close(got, want, 1e-4, 1e-5));
    }
}

#[test]
fn half_precision_moves_results_by_its_rounding_alone() {
    let Some(gpu) = half_device() else { return };
    let conv = layer([3, 21, 45], [16, 16], Padding::Replicate, Padding::Reflect);
    let case = Case::new(conv);
    let floats = case.on_gpu(&gpu, None, 0.0);
    let halves = Case { conv: halved(conv), ..case }.on_gpu(&gpu, None, 0.0);
    for (half, float) in halves[..2].iter().zip(&floats) {
        let length = |v: &mut dyn Iterator<Item = f32>| v.map(|v| v * v).sum::<f32>().sqrt();
        let error = length(&mut half.iter().zip(float).map(|(h, f)| h - f)) / length(&mut float.iter().copied());
        // Both factors of a product are off by at most 2^-11, 2^-12 on average, and the errors are independent.
        assert!(error > 1e-6 && error < 1e-3, "{error} of the length: rounded, and no more");
    }
    assert_eq!(halves[2], floats[2], "the gradient to the weights is in floats");
}

#[test]
fn half_precision_keeps_small_gradients() {
    let Some(gpu) = half_device() else { return };
    // Far below what 16 bits hold, and far above; the scale is a power of two, so not a bit may differ.
    let conv = halved(layer([3, 9, 33], [16, 16], Padding::Replicate, Padding::Reflect));
    let case = Case::new(conv);
    let [_, v_x, ..] = case.on_gpu(&gpu, None, 0.0);
    for factor in [2.0f32.powi(-40), 2.0f32.powi(40)] {
        let scaled = Case { v_y: case.v_y.iter().map(|v| v * factor).collect(), ..Case::new(conv) };
        let [_, got, ..] = scaled.on_gpu(&gpu, None, 0.0);
        let want: Vec<f32> = v_x.iter().map(|v| v * factor).collect();
        assert_close(&got, &want, 0.0, 0.0);
    }
    // A gradient that grows from frame to frame, then one that shrinks: the sums so far are brought to each new scale.
    for factors in [[1.0, 512.0, 262_144.0], [262_144.0, 512.0, 1.0f32]] {
        let frame = case.v_y.len() / 3;
        let by_frame = |v_y: &[f32]| v_y.iter().enumerate().map(|(i, v)| v * factors[i / frame]).collect::<Vec<_>>();
        let [_, got, ..] = Case { v_y: by_frame(&case.v_y), ..Case::new(conv) }.on_gpu(&gpu, None, 0.0);
        let reference = twin_of(&conv);
        let want = reference.backward_input(&by_frame(&rounded(&case.v_y)), &rounded(&case.weight));
        for (i, (got, want)) in got.chunks(frame).zip(want.chunks(frame)).enumerate() {
            let most = largest(factors[i.saturating_sub(1)..3.min(i + 2)].iter().copied());
            // As for clean data, with sums as large as those of the largest frame that meets this one.
            assert_close(got, want, 1e-4 * most, 1e-5);
        }
    }
}

#[test]
fn both_families_agree() {
    let Some(devices) = each_family() else { return };
    let conv = layer([3, 21, 45], [16, 16], Padding::Replicate, Padding::Reflect);
    let case = Case::new(Conv3d { bias: Bias::Added, ..conv });
    let [lanes, tiles] = devices.each_ref().map(|gpu| case.on_gpu(gpu, None, 0.0));
    // 432 products below 0.2 in two orders, then sums over 2835 pixels of products below 1.
    for ((tiles, lanes), atol) in tiles.iter().zip(&lanes).zip([2e-5, 2e-5, 2e-4, 2e-4]) {
        assert_close(tiles, lanes, atol, 2e-5);
    }
}

#[test]
fn adjoint_holds_on_the_gpu() {
    let Some(gpu) = device() else { return };
    let conv = layer([4, 20, 40], [4, 16], Padding::Replicate, Padding::Reflect);
    let case = Case::new(conv);
    let x = gpu.buffer_from("x", &case.x).expect("buffer");
    let weight = gpu.buffer_from("weight", &case.packed()).expect("buffer");
    let v_y = gpu.buffer_from("v_y", &case.v_y).expect("buffer");
    let mut y = gpu.buffer("y", case.v_y.len()).expect("buffer");
    let mut v_x = gpu.buffer("v_x", case.x.len()).expect("buffer");
    let mut scratch = Conv3dScratch::new(&gpu, &conv).expect("scratch");
    run(&gpu, |rec| {
        forward(rec, &conv, &x, &weight, &mut y)?;
        let from = InputGradient { v_y: &v_y, weight: &weight, gate: None };
        backward_input(rec, &conv, from, &mut v_x, &mut scratch)
    });
    let wide = |v: &[f32]| v.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let left = dot(&wide(&y.read().expect("read")), &wide(&case.v_y));
    let right = dot(&wide(&v_x.read().expect("read")), &wide(&case.x));
    // 51,200 products of size about 1, each off by about 1e-6.
    assert!((left - right).abs() < 1e-3, "<Ax, g> = {left}, <x, A'g> = {right}");
}

fn forward_of(gpu: &Gpu, conv: &Conv3d, x: &[f32], packed: &[f32]) -> Vec<f32> {
    let x = gpu.buffer_from("x", x).expect("buffer");
    let weight = gpu.buffer_from("weight", packed).expect("buffer");
    let mut y: Buffer<f32> = gpu.buffer("y", conv.shape.pixels() * conv.out_channels).expect("buffer");
    run(gpu, |rec| forward(rec, conv, &x, &weight, &mut y));
    y.read().expect("read")
}

#[test]
fn poison_reaches_exactly_its_neighbourhood() {
    let Some(gpu) = device() else { return };
    let conv = layer([3, 5, 40], [4, 4], Padding::Zero, Padding::Zero);
    for poison in [f32::NAN, f32::INFINITY] {
        let mut case = Case::new(conv);
        let bad = (5 + 2) * 40 + 20; // frame 1, row 2, column 20
        case.x[bad * 4] = poison;
        let y = forward_of(&gpu, &conv, &case.x, &case.packed());
        for (i, texel) in y.chunks_exact(4).enumerate() {
            let (t, r, c) = (i / 200, i / 40 % 5, i % 40);
            let near = t <= 2 && r.abs_diff(2) <= 1 && c.abs_diff(20) <= 1;
            assert_eq!(texel.iter().any(|v| !v.is_finite()), near, "pixel {t} {r} {c} with {poison}: {texel:?}");
        }
    }
    let relu = Conv3d { activation: Activation::Relu, ..conv };
    let mut case = Case::new(relu);
    case.x.fill(f32::NAN);
    let y = forward_of(&gpu, &relu, &case.x, &case.packed());
    assert!(y.iter().all(|v| v.is_nan()), "the ReLU hides no NaN");
    case.x.fill(1e-41);
    let y = forward_of(&gpu, &relu, &case.x, &case.packed());
    assert!(y.iter().all(|v| v.abs() < 1e-38), "denormals stay tiny");
}

#[test]
fn poison_spreads_as_in_the_twin_in_both_directions() {
    let Some(gpu) = device() else { return };
    // Sums of 108 products below 0.2, and of 81 below 1.
    spreads_poison_as(&gpu, Precision::F32, Case::on_host, (2e-5, 1e-5));
}

#[test]
fn poison_in_half_precision_spreads_as_in_the_twin() {
    let Some(gpu) = half_device() else { return };
    // As for clean data, with 108 products.
    spreads_poison_as(&gpu, Precision::Half, Case::on_host_rounded, (5e-5, 1e-5));
}

/// Every kind of poison in every operand of a small layer in this precision, against what `host` makes of it.
fn spreads_poison_as(gpu: &Gpu, precision: Precision, host: fn(&Case, &[f32]) -> [Vec<f32>; 4], tolerance: (f32, f32)) {
    let (pixels, channels) = (3 * 3 * 9, 4);
    for (time, space) in &PADDINGS[..2] {
        let conv = layer([3, 3, 9], [channels, channels], *time, *space);
        let conv = Conv3d { bias: Bias::Added, activation: Activation::Relu, precision, ..conv };
        let weight = Case::new(conv).weight;
        let len = pixels * channels;
        let case = |data: &[f32]| Case {
            conv,
            x: data[..len].to_vec(),
            weight: weight.clone(),
            bias: data[3 * len..].to_vec(),
            v_y: data[len..2 * len].to_vec(),
        };
        let gate = |data: &[f32]| data[2 * len..3 * len].to_vec();
        let clean = Random(9).vec_f32(3 * len + channels, -1.0, 1.0);
        let on_gpu = |data: &[f32]| case(data).on_gpu(gpu, Some(&gate(data)), 0.0).concat();
        let on_host = |data: &[f32]| host(&case(data), &gate(data)).concat();
        // x and v_y of the first pixel, which lanes without a pixel read too; of one inside; of the last; gate; bias.
        let inside = ((3 + 1) * 9 + 4) * channels;
        let places = [1, inside, len + 2, len + inside, 2 * len - 1, 2 * len + inside, 3 * len + 1];
        let reach = poison::spread(&clean, &places, tolerance, on_gpu, on_host);
        if (*time, *space) == PADDINGS[0] {
            // A corner has 8 neighbours and meets 8 taps, a pixel inside 27; each meets the channels of the other side.
            assert_eq!(reach[..2], [8 * 2 * channels, 27 * 2 * channels], "x: y and the weights");
            // v_y reaches the weights, the bias and those of its neighbours whose gate is open.
            for (n, taps) in reach[2..5].iter().zip([8, 27, 8]) {
                assert!((1..=taps * channels).contains(&(n - taps * channels - 1)), "v_y: {reach:?}");
            }
        }
        assert_eq!(reach[5..], [0, pixels], "a NaN in the gate lets the gradient pass, the bias reaches its channel");
    }
}

#[test]
fn wrong_shapes_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let conv = layer([1, 1, 4], [4, 4], Padding::Zero, Padding::Reflect);
    let refused = Conv3dScratch::new(&gpu, &conv);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "height", .. })), "reflection of one row: {refused:?}");
    let conv = layer([1, 2, 4], [3, 4], Padding::Zero, Padding::Zero);
    let refused = Conv3dScratch::new(&gpu, &conv);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "in_channels", .. })), "three channels: {refused:?}");

    let conv = layer([0, 4, 4], [4, 4], Padding::Zero, Padding::Zero);
    let none = gpu.buffer("none", 0).expect("buffer");
    let mut v_weight = gpu.buffer_from("v_weight", &vec![1.0; conv.weight_len()]).expect("buffer");
    let mut scratch = Conv3dScratch::new(&gpu, &conv).expect("scratch");
    let weight = upload(&gpu, &vec![1.0; conv.weight_len()]);
    let (mut y, mut v_x) = (unwritten(&gpu, 0), unwritten(&gpu, 0));
    run(&gpu, |rec| {
        forward(rec, &conv, &none, &weight, &mut y)?;
        let from = InputGradient { v_y: &none, weight: &weight, gate: None };
        backward_input(rec, &conv, from, &mut v_x, &mut scratch)?;
        let pass = WeightGradient { x: &none, v_y: &none, v_weight: &mut v_weight, accumulate: Accumulate::Overwrite };
        backward_weight(rec, &conv, pass, &mut scratch)
    });
    assert!(v_weight.read().expect("read").iter().all(|v| *v == 0.0), "no pixel, no gradient");
    let mut rec = gpu.recorder().expect("recorder");
    let recorded = forward(&mut rec, &halved(conv), &none, &weight, &mut y);
    let can = gpu.info().cooperation.is_some();
    assert!(matches!(recorded, Ok(())) == can, "16-bit floats where the device has matrices of them: {recorded:?}");
    assert!(can || matches!(recorded, Err(KernelError::Unsuitable { .. })), "{recorded:?}");
}

#[test]
fn twin_and_gpu_match_pytorch() {
    let golden = Golden::load("conv3d");
    let shape = golden.shape("x");
    let channels = [shape[3], golden.shape("v_y")[3]];
    for (name, time, space) in [("zero", Padding::Zero, Padding::Zero), ("clip", Padding::Replicate, Padding::Reflect)]
    {
        let conv = Conv3d { bias: Bias::Added, ..layer([shape[0], shape[1], shape[2]], channels, time, space) };
        let twin = twin_of(&conv);
        let [x, weight, bias, v_y] = ["x", "weight", "bias", "v_y"].map(|n| golden.f32(n));
        let want = ["y", "v_x", "v_weight", "v_bias"].map(|n| golden.f32(&format!("{name}.{n}")));
        let (v_weight, v_bias) = twin.backward_weight(&x, &v_y);
        let got = [twin.forward(&x, &weight, &bias), twin.backward_input(&v_y, &weight), v_weight, v_bias];
        // Sums of some hundred products below 1 in another order.
        got.iter().zip(&want).for_each(|(got, want)| assert_close(got, want, 1e-5, 1e-5));

        let Some(gpu) = device() else { continue };
        let case = Case { conv, x, weight, bias, v_y };
        let got = case.on_gpu(&gpu, None, 0.0);
        got.iter().zip(&want).for_each(|(got, want)| assert_close(got, want, 1e-5, 1e-5));
    }
}
