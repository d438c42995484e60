//! Matrix product, attention, layer norm and 3D convolution.

use guard4d_kernels::nn::attention::{self, AttentionShape, AttentionState, Mask, ProjectionGrads, Projections};
use guard4d_kernels::nn::conv3d::{
    self, Activation, Bias, Conv3d, Conv3dScratch, InputGradient, Padding, TAPS, WeightGradient,
};
use guard4d_kernels::nn::layer_norm::{self, LayerNorm, Rows};
use guard4d_kernels::nn::matmul::{self, Product};
use guard4d_kernels::nn::pack::PackedWeight;
use guard4d_kernels::shape::{Accumulate, ClipShape};

use crate::Outcome;
use crate::harness::{Bench, Work};

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    product(bench)?;
    attend(bench)?;
    norm(bench)?;
    convolve(bench)
}

fn product(bench: &mut Bench) -> Outcome {
    let (m, k, n) = (400, 768, 2304);
    let a = bench.data("a", m * k)?;
    let weight = PackedWeight::new(&bench.device, "w", &vec![0.01; n * k], n, k)?;
    let mut c = bench.device.buffer("c", m * n)?;
    let work = Work::Flops((2 * m * k * n) as f64, "2·m·k·n");
    bench.passes(&format!("nn/matmul {m}x{k}x{n}"), work, |rec| {
        matmul::forward(rec, &Product::plain(&a, m, &weight), &mut c)
    })
}

fn attend(bench: &mut Bench) -> Outcome {
    // The image tower of the mini CLIP on three clips of eight frames.
    let shape = AttentionShape { batch: 24, heads: 2, head_dim: 64, queries: 65, keys: 65, mask: Mask::Full };
    let (tokens, width) = (shape.batch * shape.keys, shape.width());
    let qkv = bench.data("qkv", 3 * tokens * width)?;
    let v_attn = bench.data("v_attn", tokens * width)?;
    let mut attn = bench.device.buffer("attn", tokens * width)?;
    let mut grads = bench.device.buffer("grads", 3 * tokens * width)?;
    let mut state = AttentionState::new(&bench.device, "attention", &shape)?;
    let pairs = (tokens * shape.keys * width) as f64;
    let label = format!("{}x{} heads, {} tokens of {}", shape.batch, shape.heads, shape.keys, shape.head_dim);
    bench.passes(&format!("nn/attention forward {label}"), Work::Flops(4.0 * pairs, "4·b·h·t²·d"), |rec| {
        attention::forward(rec, &shape, Projections::Fused(&qkv), &mut state, &mut attn)
    })?;
    bench.passes(&format!("nn/attention backward {label}"), Work::Flops(10.0 * pairs, "10·b·h·t²·d"), |rec| {
        let upstream = attention::Upstream { inputs: Projections::Fused(&qkv), attn: &attn, v_attn: &v_attn };
        attention::backward(rec, &shape, &upstream, &mut state, ProjectionGrads::Fused(&mut grads))
    })
}

fn norm(bench: &mut Bench) -> Outcome {
    let (rows, width) = (65_536, 128);
    let norm = LayerNorm::new(&bench.device, "norm", &vec![1.0; width], &vec![0.0; width], 1e-5)?;
    let (x, v_y) = (bench.data("x", rows * width)?, bench.data("v_y", rows * width)?);
    let mut out = bench.device.buffer("out", rows * width)?;
    let bytes = |streams: usize| (streams * 4 * rows * width) as f64;
    bench.passes(&format!("nn/layer_norm forward {rows}x{width}"), Work::Bytes(bytes(2), "2·4·rows·w"), |rec| {
        layer_norm::forward(rec, &norm, &x, Rows::all(rows), &mut out)
    })?;
    bench.passes(&format!("nn/layer_norm backward {rows}x{width}"), Work::Bytes(bytes(3), "3·4·rows·w"), |rec| {
        let upstream = layer_norm::Upstream { x: &x, v_y: &v_y, v_residual: None };
        layer_norm::backward(rec, &norm, &upstream, Rows::all(rows), &mut out)
    })
}

fn convolve(bench: &mut Bench) -> Outcome {
    let conv = Conv3d {
        shape: ClipShape { frames: 8, height: 64, width: 64 },
        in_channels: 16,
        out_channels: 16,
        time: Padding::Replicate,
        space: Padding::Reflect,
        bias: Bias::None,
        activation: Activation::Relu,
    };
    let pixels = conv.shape.pixels();
    let x = bench.data("x", pixels * conv.in_channels)?;
    let v_y = bench.data("v_y", pixels * conv.out_channels)?;
    let weight = bench.data("weight", conv.weight_len())?;
    let mut y = bench.device.buffer("y", v_y.len())?;
    let mut v_x = bench.device.buffer("v_x", x.len())?;
    let mut v_weight = bench.device.buffer("v_weight", weight.len())?;
    let mut scratch = Conv3dScratch::new(&bench.device, &conv)?;
    let work = Work::Flops((2 * TAPS * pixels * conv.in_channels * conv.out_channels) as f64, "2·27·F·H·W·Ci·Co");
    let label = "16->16, 8x64x64";
    bench
        .passes(&format!("nn/conv3d forward {label}"), work, |rec| conv3d::forward(rec, &conv, &x, &weight, &mut y))?;
    bench.passes(&format!("nn/conv3d backward to input {label}"), work, |rec| {
        let gradient = InputGradient { v_y: &v_y, weight: &weight, gate: Some(&x) };
        conv3d::backward_input(rec, &conv, gradient, &mut v_x, &mut scratch)
    })?;
    bench.passes(&format!("nn/conv3d backward to weight {label}"), work, |rec| {
        let accumulate = Accumulate::Overwrite;
        let gradient = WeightGradient { x: &x, v_y: &v_y, v_weight: &mut v_weight, accumulate };
        conv3d::backward_weight(rec, &conv, gradient, &mut scratch)
    })
}
