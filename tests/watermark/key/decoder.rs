//! Message decoder: the device against a plain f64 MLP, forward and backward, and its tensors in a file.

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::watermark::key::decoder::{Decoder, DecoderWeights, LAYERS, Linear};
use guard4d_kernels::nn::activation::Activation;
use guard4d_kernels::reference::nn::activation::{slope, value};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

const WIDTH: usize = 64;
const BITS: usize = 16;

/// Weights that keep activations near 1.
pub(crate) fn random_weights(random: &mut Random, width: usize, bits: usize) -> DecoderWeights {
    let layers = DecoderWeights::sizes(width, bits).map(|(inputs, outputs)| {
        let bound = (3.0 / inputs as f32).sqrt();
        Linear {
            weight: random.vec_f32(outputs * inputs, -bound, bound),
            bias: random.vec_f32(outputs, -0.5, 0.5),
            outputs,
            inputs,
        }
    });
    DecoderWeights { layers }
}

fn linear(layer: &Linear, x: &[f64]) -> Vec<f64> {
    let row = |(w, b): (&[f32], &f32)| f64::from(*b) + w.iter().zip(x).map(|(w, x)| f64::from(*w) * x).sum::<f64>();
    layer.weight.chunks_exact(layer.inputs).zip(&layer.bias).map(row).collect()
}

fn linear_transposed(layer: &Linear, v_y: &[f64]) -> Vec<f64> {
    let column = |j: usize| (0..layer.outputs).map(|i| f64::from(layer.weight[i * layer.inputs + j]) * v_y[i]).sum();
    (0..layer.inputs).map(column).collect()
}

/// What enters each GELU, and the logits, of one feature.
fn preactivations(weights: &DecoderWeights, feature: &[f64]) -> Vec<Vec<f64>> {
    let mut pre = vec![linear(&weights.layers[0], feature)];
    for i in 1..LAYERS {
        let hidden: Vec<f64> = pre[i - 1].iter().map(|v| value(Activation::Gelu, *v)).collect();
        pre.push(linear(&weights.layers[i], &hidden));
    }
    pre
}

/// Logits of one feature.
pub(crate) fn logits(weights: &DecoderWeights, feature: &[f64]) -> Vec<f64> {
    preactivations(weights, feature).pop().expect("there are layers")
}

/// dL/d(feature) from dL/d(logits).
fn v_feature(weights: &DecoderWeights, feature: &[f64], v_logits: &[f64]) -> Vec<f64> {
    let pre = preactivations(weights, feature);
    let mut v = linear_transposed(&weights.layers[LAYERS - 1], v_logits);
    for i in (0..LAYERS - 1).rev() {
        let gated: Vec<f64> = v.iter().zip(&pre[i]).map(|(v, x)| v * slope(Activation::Gelu, *x)).collect();
        v = linear_transposed(&weights.layers[i], &gated);
    }
    v
}

pub(crate) fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|v| f64::from(*v)).collect()
}

fn narrow(rows: &[Vec<f64>]) -> Vec<f32> {
    rows.iter().flatten().map(|v| *v as f32).collect()
}

#[test]
fn plain_gradient_agrees_with_finite_differences() {
    let mut random = Random(1);
    let weights = random_weights(&mut random, WIDTH, BITS);
    let (feature, v_logits) = (random.vec(WIDTH, -1.0, 1.0), random.vec(BITS, -1.0, 1.0));
    let loss = |x: &[f64]| logits(&weights, x).iter().zip(&v_logits).map(|(l, v)| l * v).sum::<f64>();
    let worst = gradcheck(loss, &feature, &v_feature(&weights, &feature, &v_logits));
    // Central differences in f64.
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn device_follows_the_plain_mlp_both_ways() {
    let Some(gpu) = device() else { return };
    for rows in [1, 8, 13] {
        let mut random = Random(rows as u64);
        let weights = random_weights(&mut random, WIDTH, BITS);
        let features = random.vec_f32(rows * WIDTH, -1.0, 1.0);
        let v_logits = random.vec_f32(rows * BITS, -1.0, 1.0);
        let decoder = Decoder::new(&gpu, &weights).expect("decoder");
        let mut pass = decoder.pass(&gpu, rows).expect("buffers");
        pass.v_logits.write(&v_logits).expect("upload");
        let on_device = gpu.buffer_from("features", &features).expect("buffer");
        let mut rec = gpu.recorder().expect("recorder");
        decoder.forward(&mut rec, &on_device, &mut pass).expect("records");
        decoder.backward(&mut rec, &mut pass).expect("records");
        rec.submit().expect("runs");
        let each = || features.chunks_exact(WIDTH).map(wide);
        let want: Vec<_> = each().map(|x| logits(&weights, &x)).collect();
        // Sums of up to 256 f32 products of size 0.1, through three layers.
        assert_close(&pass.logits.read().expect("read"), &narrow(&want), 2e-5, 1e-5);
        let pulled = each().zip(v_logits.chunks_exact(BITS).map(wide));
        let want: Vec<_> = pulled.map(|(x, v)| v_feature(&weights, &x, &v)).collect();
        assert_close(&pass.v_features.read().expect("read"), &narrow(&want), 2e-5, 1e-5);
    }
}

#[test]
fn nan_in_one_feature_stays_in_its_row() {
    let Some(gpu) = device() else { return };
    let mut random = Random(2);
    let decoder = Decoder::new(&gpu, &random_weights(&mut random, WIDTH, BITS)).expect("decoder");
    let mut pass = decoder.pass(&gpu, 2).expect("buffers");
    let mut features = random.vec_f32(2 * WIDTH, -1.0, 1.0);
    features[3] = f32::NAN;
    let features = gpu.buffer_from("features", &features).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    decoder.forward(&mut rec, &features, &mut pass).expect("records");
    rec.submit().expect("runs");
    let logits = pass.logits.read().expect("read");
    assert!(logits[..BITS].iter().all(|l| l.is_nan()), "the poisoned row: {logits:?}");
    assert!(logits[BITS..].iter().all(|l| l.is_finite()), "the other row: {logits:?}");
}

#[test]
fn file_gives_back_what_was_stored_and_names_what_is_wrong() {
    let weights = random_weights(&mut Random(3), WIDTH, BITS);
    let mut file = TensorFile::default();
    weights.store(&mut file);
    assert_eq!(DecoderWeights::load(&file, WIDTH, BITS).expect("loads"), weights, "round trip");
    assert_eq!((weights.width(), weights.bits()), (WIDTH, BITS), "sizes");
    let error = DecoderWeights::load(&file, WIDTH, BITS + 8).expect_err("another length").to_string();
    assert!(error.contains("decoder.2.weight"), "{error}");
    file.tensors.remove("decoder.1.bias");
    let error = DecoderWeights::load(&file, WIDTH, BITS).expect_err("a tensor is gone").to_string();
    assert!(error.contains("decoder.1.bias"), "{error}");
}
