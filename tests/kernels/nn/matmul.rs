//! nn/matmul

use guard4d_kernels::nn::activation::Activation;
use guard4d_kernels::nn::matmul::{Epilogue, GradScratch, Product, forward, weight_gradient};
use guard4d_kernels::nn::pack::{PackedWeight, Precision};
use guard4d_kernels::reference::nn::{matmul as twin, pack as pack_twin};
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{device, each_family, half_device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

/// (rows, n, k): every tile width, rows that do not fill a tile, and so many rows and columns that GPUs get large
/// tiles.
const SHAPES: [(usize, usize, usize); 9] = [
    (1, 8, 4),
    (7, 16, 8),
    (16, 32, 12),
    (17, 48, 20),
    (33, 96, 64),
    (5, 40, 36),
    (50, 24, 16),
    (16, 128, 128),
    (1030, 1032, 36),
];

#[test]
fn twin_gradients_match_differences() {
    let (rows, n, k) = (3, 5, 4);
    let mut random = Random(3);
    let (a, w, bias) = (random.vec(rows * k, -1.0, 1.0), random.vec(n * k, -1.0, 1.0), random.vec(n, -1.0, 1.0));
    let v_c = random.vec(rows * n, -1.0, 1.0);
    let w_t: Vec<f64> = (0..k * n).map(|i| w[(i % n) * k + i / n]).collect();
    let act = Activation::QuickGelu;
    let loss = |a: &[f64], w: &[f64]| dot(&twin::forward(a, w, &bias, k, twin::Epilogue::Activate(act)), &v_c);
    let pre = twin::forward(&a, &w, &bias, k, twin::Epilogue::Activate(Activation::Identity));
    // v_pre = v_c act'(pre): the epilogue of a product with the unit matrix.
    let unit: Vec<f64> = (0..n * n).map(|i| f64::from(u8::from(i % n == i / n))).collect();
    let v_pre = twin::forward(&v_c, &unit, &vec![0.0; n], n, twin::Epilogue::Grad(act, &pre));
    let v_a = twin::forward(&v_pre, &w_t, &vec![0.0; k], n, twin::Epilogue::Activate(Activation::Identity));
    let error_a = gradcheck(|a| loss(a, &w), &a, &v_a);
    let error_w = gradcheck(|w| loss(&a, w), &w, &twin::weight_gradient(&a, &v_pre, n, k));
    assert!(error_a < 1e-6 && error_w < 1e-6, "{error_a} {error_w}");
}

/// Runs every shape with every epilogue on weights of this precision; `check` gets what came out and what the twin says
/// of operands that went through `operand`.
fn each_product(gpu: &Device, precision: Precision, operand: fn(&[f32]) -> Vec<f32>, check: impl Fn(&[f32], &[f32])) {
    for (rows, n, k) in SHAPES {
        let mut random = Random((rows * n * k) as u64);
        let (a, w) = (random.vec_f32(rows * k, -1.0, 1.0), random.vec_f32(n * k, -1.0, 1.0));
        let (bias, aux) = (random.vec_f32(n, -1.0, 1.0), random.vec_f32(rows * n, -1.0, 1.0));
        let weight = PackedWeight::in_precision(gpu, "w", &w, n, k, precision).expect("packs");
        let (a_buffer, bias_buffer, aux_buffer) = (upload(gpu, &a), upload(gpu, &bias), upload(gpu, &aux));
        let cases = [
            (Epilogue::Activate(Activation::Relu), twin::Epilogue::Activate(Activation::Relu)),
            (Epilogue::Add(&aux_buffer), twin::Epilogue::Add(&aux)),
            (Epilogue::Grad(Activation::QuickGelu, &aux_buffer), twin::Epilogue::Grad(Activation::QuickGelu, &aux)),
        ];
        for (epilogue, twin_epilogue) in cases {
            let mut c = unwritten(gpu, rows * n);
            let product = Product { a: &a_buffer, rows, weight: &weight, bias: Some(&bias_buffer), epilogue };
            run(gpu, |rec| forward(rec, &product, &mut c));
            check(&c.read().expect("read"), &twin::forward(&operand(&a), &operand(&w), &bias, k, twin_epilogue));
        }
    }
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    // k <= 128 terms below 1 in the twin's order: equal but for rounding, which k * 2^-24 bounds.
    each_product(&gpu, Precision::F32, <[f32]>::to_vec, |c, want| assert_close(c, want, 1e-5, 1e-5));
}

#[test]
fn sixteen_bit_weights_follow_the_rounded_twin() {
    let Some(gpu) = device() else { return };
    for (rows, n, k) in SHAPES.into_iter().filter(|(_, n, _)| n % 16 == 0) {
        let mut random = Random((rows + n * k) as u64);
        let a = random.vec_f32(rows * k, -1.0, 1.0);
        // Rows of very different sizes, each with its own scale; one of zeros has none.
        let sizes = [1.0, 1e-3, 1e3, 0.0];
        let w: Vec<f32> =
            random.vec_f32(n * k, -1.0, 1.0).iter().enumerate().map(|(i, v)| v * sizes[i / k % 4]).collect();
        let bias = random.vec_f32(n, -1.0, 1.0);
        let weight = PackedWeight::in_precision(&gpu, "w", &w, n, k, Precision::Fixed16).expect("packs");
        let (a_buffer, bias_buffer) = (upload(&gpu, &a), upload(&gpu, &bias));
        let mut c = unwritten(&gpu, rows * n);
        let product = Product { bias: Some(&bias_buffer), ..Product::plain(&a_buffer, rows, &weight) };
        run(&gpu, |rec| forward(rec, &product, &mut c));
        let identity = twin::Epilogue::Activate(Activation::Identity);
        let c = c.read().expect("read");
        let rounded = twin::forward(&a, &pack_twin::fixed16(&w, k), &bias, k, identity);
        let exact = twin::forward(&a, &w, &bias, k, identity);
        for (i, ((c, rounded), exact)) in c.iter().zip(&rounded).zip(&exact).enumerate() {
            let size = sizes[i % n % 4];
            // The codes are summed before they are scaled: k rounding errors of at most 2^-24 of k terms below `size`.
            let rounding = 2e-7 * (k as f32) * (size + 1.0);
            assert!((c - rounded).abs() <= rounding, "{i}: {c} for {rounded} in {rows}x{n}x{k}");
            // An element is off by half a code, that is size / 65534, and |a| <= 1.
            let off = (k as f32) * size / 65_534.0 + rounding;
            assert!((c - exact).abs() <= off, "{i}: {c} for {exact} in {rows}x{n}x{k}");
        }
    }
}

#[test]
fn sixteen_bit_weights_pass_poison_on() {
    let Some(gpu) = device() else { return };
    let (n, k) = (16, 8);
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut w = Random(8).vec_f32(n * k, -1.0, 1.0);
        w[3 * k + 5] = poison;
        let weight = PackedWeight::in_precision(&gpu, "w", &w, n, k, Precision::Fixed16).expect("packs");
        let a = upload(&gpu, &vec![1.0; k]);
        let mut c = unwritten(&gpu, n);
        run(&gpu, |rec| forward(rec, &Product::plain(&a, 1, &weight), &mut c));
        let finite: Vec<bool> = c.read().expect("read").iter().map(|v| v.is_finite()).collect();
        assert_eq!(finite, (0..n).map(|row| row != 3).collect::<Vec<_>>(), "row 3 alone, for {poison}");
    }
    let odd = PackedWeight::in_precision(&gpu, "w", &[1.0; 64], 8, 8, Precision::Fixed16);
    assert!(matches!(odd, Err(KernelError::Shape { .. })), "lane-blocks come in pairs: {odd:?}");
}

/// The operands as cooperative matrices take them.
fn rounded(x: &[f32]) -> Vec<f32> {
    x.iter().map(|v| half::f16::from_f32(*v).to_f32()).collect()
}

#[test]
fn half_precision_follows_the_twin_on_rounded_operands() {
    let Some(gpu) = half_device() else { return };
    // Products of two f16 are exact in f32. Units that add several at once may drop what lies 2^-22 below the largest
    // partial sum, here about 10, in each of k/4 steps.
    each_product(&gpu, Precision::Half, rounded, |c, want| assert_close(c, want, 1e-4, 1e-5));
}

#[test]
fn half_precision_keeps_small_gradients() {
    let Some(gpu) = half_device() else { return };
    let (rows, n, k) = (70, 72, 100);
    let mut random = Random(9);
    let (v_c, w) = (random.vec_f32(rows * k, -1.0, 1.0), random.vec_f32(n * k, -1.0, 1.0));
    let adjoint = PackedWeight::transposed(&gpu, "w", &w, n, k, Precision::Half).expect("packs");
    let v_a = |v_c: &[f32]| {
        let (v_c, mut v_a) = (upload(&gpu, v_c), unwritten(&gpu, rows * n));
        run(&gpu, |rec| forward(rec, &Product::plain(&v_c, rows, &adjoint), &mut v_a));
        v_a.read().expect("read")
    };
    let times = |v: &[f32], factor: f32| v.iter().map(|v| v * factor).collect::<Vec<_>>();
    let plain = v_a(&v_c);
    // Far below what 16 bits hold, and far above; the scale is a power of two, so not a bit may differ.
    for factor in [2.0f32.powi(-40), 2.0f32.powi(40)] {
        assert_close(&v_a(&times(&v_c, factor)), &times(&plain, factor), 0.0, 0.0);
    }
    // Larger from one panel of 32 to the next, then smaller: the sums so far are brought to each new scale.
    let w_t: Vec<f32> = (0..n * k).map(|i| w[(i % k) * n + i / k]).collect();
    for [start, step] in [[1.0, 64.0], [262_144.0, 1.0 / 64.0f32]] {
        let by_panel = |v: &[f32]| -> Vec<f32> {
            v.iter().enumerate().map(|(i, v)| v * start * step.powi((i % k / 32) as i32)).collect()
        };
        let identity = twin::Epilogue::Activate(Activation::Identity);
        let want = twin::forward(&by_panel(&rounded(&v_c)), &rounded(&w_t), &vec![0.0; n], k, identity);
        // As for clean data, with sums 2^18 times as large.
        assert_close(&v_a(&by_panel(&v_c)), &want, 1e-4 * 262_144.0, 1e-5);
    }
}

#[test]
fn poison_in_half_precision_stays_in_its_row_or_column() {
    let Some(gpu) = half_device() else { return };
    let (rows, n, k) = (70, 72, 40);
    let clean = Random(8).vec_f32(rows * k + n * k, -1.0, 1.0);
    let on_gpu = |data: &[f32]| {
        let weight = PackedWeight::in_precision(&gpu, "w", &data[rows * k..], n, k, Precision::Half).expect("packs");
        let a = upload(&gpu, &data[..rows * k]);
        let mut c = unwritten(&gpu, rows * n);
        run(&gpu, |rec| forward(rec, &Product::plain(&a, rows, &weight), &mut c));
        c.read().expect("read")
    };
    let on_host = |data: &[f32]| {
        let data = rounded(data);
        let identity = twin::Epilogue::Activate(Activation::Identity);
        twin::forward(&data[..rows * k], &data[rows * k..], &vec![0.0; n], k, identity)
    };
    // As above with k = 40. The last row and the last column lie in tiles that are not full.
    let places = [3, (rows - 1) * k + 39, rows * k + 9 * k + 1, rows * k + (n - 1) * k + 38];
    let reach = poison::spread(&clean, &places, (1e-4, 1e-5), on_gpu, on_host);
    assert_eq!(reach, [n, n, rows, rows], "rows of A, columns of W");
}

#[test]
fn sizes_are_padded_at_load() {
    let Some(gpu) = device() else { return };
    let (rows, n, k) = (9, 11, 6);
    let mut random = Random(5);
    let (a, w) = (random.vec_f32(rows * 8, -1.0, 1.0), random.vec_f32(n * k, -1.0, 1.0));
    let weight = PackedWeight::new(&gpu, "w", &w, n, k).expect("packs");
    assert_eq!((weight.n(), weight.k()), (16, 8), "padded sizes");
    let mut c = unwritten(&gpu, rows * 16);
    let a_buffer = upload(&gpu, &a);
    run(&gpu, |rec| forward(rec, &Product::plain(&a_buffer, rows, &weight), &mut c));
    let mut padded = vec![0.0; 16 * 8];
    (0..n).for_each(|row| padded[row * 8..row * 8 + k].copy_from_slice(&w[row * k..][..k]));
    let identity = twin::Epilogue::Activate(Activation::Identity);
    // As above with k = 8.
    assert_close(&c.read().expect("read"), &twin::forward(&a, &padded, &[0.0; 16], 8, identity), 1e-6, 1e-6);
}

#[test]
fn weight_gradient_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (rows, n, k) in [(1, 8, 8), (13, 16, 40), (64, 48, 24)] {
        let mut random = Random((rows + n + k) as u64);
        let (a, v_c) = (random.vec_f32(rows * k, -1.0, 1.0), random.vec_f32(rows * n, -1.0, 1.0));
        let (a_buffer, v_c_buffer) = (upload(&gpu, &a), upload(&gpu, &v_c));
        let mut scratch = GradScratch::new(&gpu, "w", rows, n, k).expect("scratch");
        let mut v_w = unwritten(&gpu, n * k);
        run(&gpu, |rec| weight_gradient(rec, &a_buffer, &v_c_buffer, &mut scratch, &mut v_w));
        // At most 64 terms below 1, summed in the same order.
        assert_close(&v_w.read().expect("read"), &twin::weight_gradient(&a, &v_c, n, k), 1e-5, 1e-5);
    }
}

#[test]
fn both_families_agree() {
    let Some(devices) = each_family() else { return };
    let (rows, n, k) = (70, 1040, 1032);
    let mut random = Random(11);
    let (a, w) = (random.vec_f32(rows * k, -1.0, 1.0), random.vec_f32(n * k, -1.0, 1.0));
    let (aux, v_c) = (random.vec_f32(rows * n, -1.0, 1.0), random.vec_f32(rows * n, -1.0, 1.0));
    let [lanes, tiles] = devices.map(|gpu| {
        let weight = PackedWeight::new(&gpu, "w", &w, n, k).expect("packs");
        let [a, aux, v_c] = [&a, &aux, &v_c].map(|data| upload(&gpu, data));
        let codes = PackedWeight::in_precision(&gpu, "w", &w, n, k, Precision::Fixed16).expect("packs");
        let [mut c, mut coded] = [(); 2].map(|()| unwritten(&gpu, rows * n));
        let mut v_w = unwritten(&gpu, n * k);
        let mut scratch = GradScratch::new(&gpu, "w", rows, n, k).expect("scratch");
        run(&gpu, |rec| {
            forward(rec, &Product { epilogue: Epilogue::Add(&aux), ..Product::plain(&a, rows, &weight) }, &mut c)?;
            forward(rec, &Product { epilogue: Epilogue::Add(&aux), ..Product::plain(&a, rows, &codes) }, &mut coded)?;
            weight_gradient(rec, &a, &v_c, &mut scratch, &mut v_w)
        });
        [c, coded, v_w].map(|buffer| buffer.read().expect("read"))
    });
    // Both add 1032 (70) products below 1 in one order; a device may round after each or fuse it with its sum.
    assert_close(&tiles[0], &lanes[0], 1e-4, 1e-5);
    assert_close(&tiles[1], &lanes[1], 1e-4, 1e-5);
    assert_close(&tiles[2], &lanes[2], 1e-5, 1e-5);
}

#[test]
fn poison_stays_in_its_row_or_column() {
    let Some(gpu) = device() else { return };
    let (rows, n, k) = (19, 48, 8);
    let clean = Random(6).vec_f32(rows * k + n * k + n + rows * n, -1.0, 1.0);
    let (w, bias, aux) = (rows * k, rows * k + n * k, rows * k + n * k + n);
    for mode in 0..3 {
        let on_gpu = |data: &[f32]| {
            let weight = PackedWeight::new(&gpu, "w", &data[w..bias], n, k).expect("packs");
            let [a, bias, aux] = [&data[..w], &data[bias..aux], &data[aux..]].map(|d| upload(&gpu, d));
            let epilogue = [
                Epilogue::Activate(Activation::Relu),
                Epilogue::Add(&aux),
                Epilogue::Grad(Activation::QuickGelu, &aux),
            ][mode];
            let mut c = unwritten(&gpu, rows * n);
            run(&gpu, |rec| {
                forward(rec, &Product { a: &a, rows, weight: &weight, bias: Some(&bias), epilogue }, &mut c)
            });
            c.read().expect("read")
        };
        let on_host = |data: &[f32]| {
            let aux_data = &data[aux..];
            let epilogue = [
                twin::Epilogue::Activate(Activation::Relu),
                twin::Epilogue::Add(aux_data),
                twin::Epilogue::Grad(Activation::QuickGelu, aux_data),
            ][mode];
            twin::forward(&data[..w], &data[w..bias], &data[bias..aux], k, epilogue)
        };
        // As above with k = 8. Row 17 lies in the second tile, which is not full.
        let places = [3, 17 * k + 5, w + 9 * k + 1, bias + 40, aux + 18 * n];
        let reach = poison::spread(&clean, &places, (1e-5, 1e-5), on_gpu, on_host);
        assert_eq!(reach, [n, n, rows, rows, usize::from(mode > 0)], "rows of A, columns of W and bias, mode {mode}");
    }
}

#[test]
fn poison_reaches_its_row_or_column_of_the_weight_gradient_and_no_rows_give_zero() {
    let Some(gpu) = device() else { return };
    let (n, k) = (16, 40);
    let on_gpu = |rows: usize, data: &[f32]| {
        let (a, v_c) = (upload(&gpu, &data[..rows * k]), upload(&gpu, &data[rows * k..]));
        let mut scratch = GradScratch::new(&gpu, "w", rows, n, k).expect("scratch");
        let mut v_w = unwritten(&gpu, n * k);
        run(&gpu, |rec| weight_gradient(rec, &a, &v_c, &mut scratch, &mut v_w));
        v_w.read().expect("read")
    };
    assert_eq!(on_gpu(0, &[]), vec![0.0; n * k], "an empty sum");
    // The last row is followed by padding.
    let rows = 13;
    let clean = Random(7).vec_f32(rows * (k + n), -1.0, 1.0);
    let on_host = |data: &[f32]| twin::weight_gradient(&data[..rows * k], &data[rows * k..], n, k);
    // Sums of 13 terms below 1.
    let places = [12 * k + 5, rows * k + 12 * n + 3];
    let reach = poison::spread(&clean, &places, (1e-5, 1e-5), |data| on_gpu(rows, data), on_host);
    assert_eq!(reach, [n, k], "a column of A, a column of v_c");
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let weight = PackedWeight::new(&gpu, "w", &[1.0; 64], 8, 8).expect("packs");
    let (a, mut c) = (upload(&gpu, &[1.0; 24]), unwritten(&gpu, 24));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, &Product::plain(&a, 2, &weight), &mut c);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "a", .. })), "{wrong:?}");
    let short_bias = Product { bias: Some(&a), ..Product::plain(&a, 3, &weight) };
    let wrong = forward(&mut rec, &short_bias, &mut c);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "bias", .. })), "{wrong:?}");
    let wrong = PackedWeight::new(&gpu, "w", &[1.0; 63], 8, 8);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "w", .. })), "{wrong:?}");
    let (empty, mut none) = (upload(&gpu, &[]), unwritten(&gpu, 0));
    run(&gpu, |rec| forward(rec, &Product::plain(&empty, 0, &weight), &mut none));
}
