//! Matrix product, attention, 3D convolution, and the smaller parts of the networks.

use guard4d_kernels::nn::activation::{self, Activation as Pointwise};
use guard4d_kernels::nn::attention::{self, AttentionShape, AttentionState, Mask, ProjectionGrads, Projections};
use guard4d_kernels::nn::conv2d::{self, Conv2d, FilterBank, Filters};
use guard4d_kernels::nn::conv3d::{
    self, Activation, Bias, Conv3d, Conv3dScratch, InputGradient, Padding, TAPS, WeightGradient,
};
use guard4d_kernels::nn::embedding::{self, Tables};
use guard4d_kernels::nn::layer_norm::{self, LayerNorm, Rows};
use guard4d_kernels::nn::matmul::{self, GradScratch, Product};
use guard4d_kernels::nn::max_pool::{self, MaxPool};
use guard4d_kernels::nn::pack::{self, Order, PackedWeight, Precision};
use guard4d_kernels::nn::patch_embed::{self, PatchShape};
use guard4d_kernels::nn::{axpy, column_sum, l2_normalize, row_mean, transpose};
use guard4d_kernels::registry::nn::{
    matmul_fwd_fixed16, matmul_fwd_fixed16_tile, matmul_fwd_windows, matmul_fwd_windows_tile,
};
use guard4d_kernels::shape::{Accumulate, ClipShape};

use crate::harness::{Bench, Outcome, Work};

/// Rows and columns of the kernels that take rows: 32 MiB, more than a cache holds.
const ROWS: usize = 65_536;
const WIDTH: usize = 128;

pub(crate) fn measure(bench: &mut Bench) -> Outcome {
    product(bench)?;
    rearrange(bench)?;
    attend(bench)?;
    norm(bench)?;
    pointwise(bench)?;
    reduce(bench)?;
    patches(bench)?;
    tokens(bench)?;
    convolve(bench)?;
    filter(bench)
}

/// Bytes of this many passes over `[ROWS, WIDTH]`.
fn streams(count: usize) -> Work {
    let formula = if count == 2 { "2·4·rows·w" } else { "3·4·rows·w" };
    Work::Bytes((count * 4 * ROWS * WIDTH) as f64, formula)
}

/// The products of a transformer layer of CLIP ViT-B/32 on eight images, and one gradient.
fn product(bench: &mut Bench) -> Outcome {
    let m = 400;
    for (n, k) in [(768, 768), (2304, 768), (3072, 768), (768, 3072)] {
        let a = bench.data("a", m * k)?;
        let weight = PackedWeight::new(&bench.device, "w", &vec![0.01; n * k], n, k)?;
        let mut c = bench.device.buffer("c", m * n)?;
        let work = Work::Flops((2 * m * k * n) as f64, "2·m·k·n");
        bench.passes(&format!("nn/matmul {m}x{k}x{n}"), work, |rec| {
            matmul::forward(rec, &Product::plain(&a, m, &weight), &mut c)
        })?;
        let codes = PackedWeight::in_precision(&bench.device, "w", &vec![0.01; n * k], n, k, Precision::Fixed16)?;
        let coded = format!("nn/matmul {m}x{k}x{n}, 16-bit weights");
        bench.passes(&coded, work, |rec| matmul::forward(rec, &Product::plain(&a, m, &codes), &mut c))?;
        bench.expect(&coded, &[&matmul_fwd_fixed16::KERNEL, &matmul_fwd_fixed16_tile::KERNEL])?;
        if bench.device.info().cooperation.is_some() {
            let half = PackedWeight::in_precision(&bench.device, "w", &vec![0.01; n * k], n, k, Precision::Half)?;
            bench.passes(&format!("nn/matmul {m}x{k}x{n}, f16"), work, |rec| {
                matmul::forward(rec, &Product::plain(&a, m, &half), &mut c)
            })?;
        }
    }
    let (n, k) = (2304, 768);
    let (a, c) = (bench.data("a", m * k)?, bench.data("c", m * n)?);
    let work = Work::Flops((2 * m * k * n) as f64, "2·m·k·n");
    let mut scratch = GradScratch::new(&bench.device, "gradient", m, n, k)?;
    let mut v_w = bench.device.buffer("v_w", n * k)?;
    bench.passes(&format!("nn/matmul weight_gradient {m}x{k}x{n}"), work, |rec| {
        matmul::weight_gradient(rec, &a, &c, &mut scratch, &mut v_w)
    })
}

/// What brings operands into the order that a product wants.
fn rearrange(bench: &mut Bench) -> Outcome {
    let (rows, cols) = (4096, 2048);
    let work = Work::Bytes((8 * rows * cols) as f64, "2·4·rows·cols");
    let x = bench.data("x", rows * cols)?;
    let mut y = bench.device.buffer("y", rows * cols)?;
    bench.passes(&format!("nn/transpose {rows}x{cols}"), work, |rec| transpose::copy(rec, &x, rows, cols, &mut y))?;
    let mut packed = PackedWeight::zeros(&bench.device, "packed", rows, cols)?;
    for (order, name) in [(Order::Rows { stride: cols }, "rows"), (Order::Columns { stride: rows }, "columns")] {
        bench.passes(&format!("nn/pack from {name} {rows}x{cols}"), work, |rec| {
            pack::gather(rec, &x, order, &mut packed)
        })?;
    }
    Ok(())
}

/// Floats, and 16-bit floats where the device multiplies matrices of them, each with the end of a row's name.
fn precisions(bench: &Bench) -> Vec<(Precision, &'static str)> {
    let half = bench.device.info().cooperation.map(|_| (Precision::Half, ", f16"));
    std::iter::once((Precision::F32, "")).chain(half).collect()
}

fn attend(bench: &mut Bench) -> Outcome {
    precisions(bench).into_iter().try_for_each(|(precision, kept)| attend_in(bench, precision, kept))
}

fn attend_in(bench: &mut Bench, precision: Precision, kept: &str) -> Outcome {
    // The image tower of the mini CLIP on three clips of eight frames.
    let mask = Mask::Full;
    let shape = AttentionShape { batch: 24, heads: 2, head_dim: 64, queries: 65, keys: 65, mask, precision };
    let (tokens, width) = (shape.batch * shape.keys, shape.width());
    let qkv = bench.data("qkv", 3 * tokens * width)?;
    let v_attn = bench.data("v_attn", tokens * width)?;
    let mut attn = bench.device.buffer("attn", tokens * width)?;
    let mut grads = bench.device.buffer("grads", 3 * tokens * width)?;
    let mut state = AttentionState::new(&bench.device, "attention", &shape)?;
    let pairs = (tokens * shape.keys * width) as f64;
    let label = format!("{}x{} heads, {} tokens of {}{kept}", shape.batch, shape.heads, shape.keys, shape.head_dim);
    bench.passes(&format!("nn/attention forward {label}"), Work::Flops(4.0 * pairs, "4·b·h·t²·d"), |rec| {
        attention::forward(rec, &shape, Projections::Fused(&qkv), &mut state, &mut attn)
    })?;
    bench.passes(&format!("nn/attention backward {label}"), Work::Flops(10.0 * pairs, "10·b·h·t²·d"), |rec| {
        let upstream = attention::Upstream { inputs: Projections::Fused(&qkv), attn: &attn, v_attn: &v_attn };
        attention::backward(rec, &shape, &upstream, &mut state, ProjectionGrads::Fused(&mut grads))
    })
}

fn norm(bench: &mut Bench) -> Outcome {
    let norm = LayerNorm::new(&bench.device, "norm", &[1.0; WIDTH], &[0.0; WIDTH], 1e-5)?;
    let (x, v_y) = (bench.data("x", ROWS * WIDTH)?, bench.data("v_y", ROWS * WIDTH)?);
    let mut out = bench.device.buffer("out", ROWS * WIDTH)?;
    bench.passes(&format!("nn/layer_norm forward {ROWS}x{WIDTH}"), streams(2), |rec| {
        layer_norm::forward(rec, &norm, &x, Rows::all(ROWS), &mut out)
    })?;
    bench.passes(&format!("nn/layer_norm backward {ROWS}x{WIDTH}"), streams(3), |rec| {
        let upstream = layer_norm::Upstream { x: &x, v_y: &v_y, v_residual: None };
        layer_norm::backward(rec, &norm, &upstream, Rows::all(ROWS), &mut out)
    })?;
    bench.passes(&format!("nn/l2_normalize forward {ROWS}x{WIDTH}"), streams(2), |rec| {
        l2_normalize::forward(rec, &x, WIDTH, &mut out)
    })?;
    bench.passes(&format!("nn/l2_normalize backward {ROWS}x{WIDTH}"), streams(3), |rec| {
        l2_normalize::backward(rec, &x, &v_y, WIDTH, &mut out)
    })
}

fn pointwise(bench: &mut Bench) -> Outcome {
    let (x, v_y) = (bench.data("x", ROWS * WIDTH)?, bench.data("v_y", ROWS * WIDTH)?);
    let mut out = bench.device.buffer("out", ROWS * WIDTH)?;
    for (function, name) in [(Pointwise::QuickGelu, "quick GELU"), (Pointwise::Gelu, "GELU")] {
        bench.passes(&format!("nn/activation forward {name} {ROWS}x{WIDTH}"), streams(2), |rec| {
            activation::forward(rec, function, &x, &mut out)
        })?;
        bench.passes(&format!("nn/activation backward {name} {ROWS}x{WIDTH}"), streams(3), |rec| {
            activation::backward(rec, function, &x, &v_y, &mut out)
        })?;
    }
    bench.passes(&format!("nn/axpy forward {ROWS}x{WIDTH}"), streams(3), |rec| {
        axpy::forward(rec, 0.5, &x, &v_y, &mut out)
    })?;
    bench
        .passes(&format!("nn/axpy backward {ROWS}x{WIDTH}"), streams(2), |rec| axpy::backward(rec, 0.5, &v_y, &mut out))
}

fn reduce(bench: &mut Bench) -> Outcome {
    let x = bench.data("x", ROWS * WIDTH)?;
    let mut mean = bench.device.buffer("mean", ROWS)?;
    let work = Work::Bytes((4 * ROWS * (WIDTH + 1)) as f64, "4·rows·(w + 1)");
    bench.passes(&format!("nn/row_mean {ROWS}x{WIDTH}"), work, |rec| row_mean::forward(rec, &x, WIDTH, &mut mean))?;
    // Half as many rows: a lane may not walk all of them.
    let (rows, width) = (ROWS / 2, WIDTH * 2);
    let mut sum = bench.device.buffer("sum", width)?;
    let work = Work::Bytes((4 * width * (rows + 1)) as f64, "4·w·(rows + 1)");
    bench.passes(&format!("nn/column_sum {rows}x{width}"), work, |rec| column_sum::forward(rec, &x, &mut sum))
}

fn patches(bench: &mut Bench) -> Outcome {
    let shape = PatchShape { batch: 192, side_px: 64, patch_px: 8 };
    let mut pixels = bench.data("pixels", shape.pixels_len())?;
    let mut rows = bench.device.buffer("rows", shape.rows_len())?;
    let work = Work::Bytes((4 * (shape.pixels_len() + shape.rows_len())) as f64, "16·b·s² + 16·b·t·p²");
    let label = format!("{} images of {} px, patch {}", shape.batch, shape.side_px, shape.patch_px);
    bench.passes(&format!("nn/patch_embed unfold {label}"), work, |rec| {
        patch_embed::unfold(rec, shape, &pixels, &mut rows)
    })?;
    bench.passes(&format!("nn/patch_embed fold {label}"), work, |rec| patch_embed::fold(rec, shape, &rows, &mut pixels))
}

fn tokens(bench: &mut Bench) -> Outcome {
    // Messages of 16 bits, with a begin and an end token, in the text tower of the mini CLIP.
    let (sequences, tokens, vocabulary) = (4096, 18, 49_408);
    let rows = sequences * tokens;
    let ids: Vec<u32> = (0..rows as u32).map(|i| i * 7919 % vocabulary as u32).collect();
    let ids = bench.device.buffer_from("ids", &ids)?;
    let (table, position) = (bench.data("table", vocabulary * WIDTH)?, bench.data("position", tokens * WIDTH)?);
    let mut y = bench.device.buffer("y", rows * WIDTH)?;
    let tables = Tables { table: &table, position: &position, width: WIDTH };
    let work = Work::Bytes((4 * rows * (1 + 2 * WIDTH)) as f64, "4·rows·(1 + 2·w)");
    bench.passes(&format!("nn/embedding {sequences} sequences of {tokens} tokens, width {WIDTH}"), work, |rec| {
        embedding::gather(rec, &tables, &ids, tokens, &mut y)
    })
}

/// A layer of R on clips of this side.
fn layer(side: usize, in_channels: usize, out_channels: usize, precision: Precision) -> Conv3d {
    Conv3d {
        shape: ClipShape { frames: 8, height: side, width: side },
        in_channels,
        out_channels,
        time: Padding::Replicate,
        space: Padding::Reflect,
        bias: Bias::None,
        activation: Activation::Relu,
        precision,
    }
}

/// The layers of R at the size of CLIP's input, and the gradients of one at the size of the mini CLIP's.
fn convolve(bench: &mut Bench) -> Outcome {
    precisions(bench).into_iter().try_for_each(|(precision, kept)| convolve_in(bench, precision, kept))
}

fn convolve_in(bench: &mut Bench, precision: Precision, kept: &str) -> Outcome {
    for (given, outputs) in [(16, 16), (3, 16), (16, 3)] {
        // Three channels are stored as four; what the fourth costs is no useful work.
        let conv = layer(224, usize::next_multiple_of(given, 4), usize::next_multiple_of(outputs, 4), precision);
        let pixels = conv.shape.pixels();
        let (x, weight) = (bench.data("x", pixels * conv.in_channels)?, bench.data("weight", conv.weight_len())?);
        let mut y = bench.device.buffer("y", pixels * conv.out_channels)?;
        let work = Work::Flops((2 * TAPS * pixels * given * outputs) as f64, "2·27·F·H·W·Ci·Co");
        bench.passes(&format!("nn/conv3d forward {given}->{outputs}, 8x224x224{kept}"), work, |rec| {
            conv3d::forward(rec, &conv, &x, &weight, &mut y)
        })?;
    }
    let conv = layer(64, 16, 16, precision);
    let pixels = conv.shape.pixels();
    let x = bench.data("x", pixels * conv.in_channels)?;
    let v_y = bench.data("v_y", pixels * conv.out_channels)?;
    let weight = bench.data("weight", conv.weight_len())?;
    let mut y = bench.device.buffer("y", v_y.len())?;
    let mut v_x = bench.device.buffer("v_x", x.len())?;
    let mut v_weight = bench.device.buffer("v_weight", weight.len())?;
    let mut scratch = Conv3dScratch::new(&bench.device, &conv)?;
    let work = Work::Flops((2 * TAPS * pixels * conv.in_channels * conv.out_channels) as f64, "2·27·F·H·W·Ci·Co");
    let label = format!("16->16, 8x64x64{kept}");
    bench
        .passes(&format!("nn/conv3d forward {label}"), work, |rec| conv3d::forward(rec, &conv, &x, &weight, &mut y))?;
    bench.passes(&format!("nn/conv3d backward to input {label}"), work, |rec| {
        let gradient = InputGradient { v_y: &v_y, weight: &weight, gate: Some(&x) };
        conv3d::backward_input(rec, &conv, gradient, &mut v_x, &mut scratch)
    })?;
    if precision == Precision::Half {
        return Ok(()); // The gradient to the weights is in floats.
    }
    bench.passes(&format!("nn/conv3d backward to weight {label}"), work, |rec| {
        let accumulate = Accumulate::Overwrite;
        let gradient = WeightGradient { x: &x, v_y: &v_y, v_weight: &mut v_weight, accumulate };
        conv3d::backward_weight(rec, &conv, gradient, &mut scratch)
    })
}

/// Layers of `AlexNet` on eight frames of 200 px, as LPIPS sees them: 24 x 24 pixels after the first pooling, 11 x 11
/// after the second.
fn filter(bench: &mut Bench) -> Outcome {
    for (side, inputs, outputs, taps) in [(24, 64, 192, 5), (11, 192, 384, 3), (11, 256, 256, 3)] {
        let weight = vec![0.01; outputs * inputs * taps * taps];
        let bank =
            FilterBank { weight: &weight, bias: &vec![0.0; outputs], out_channels: outputs, in_channels: inputs, taps };
        let filters = Filters::new(&bench.device, "filters", &bank)?;
        let conv = Conv2d { frames: 8, height: side, width: side, padding: taps / 2 };
        let pixels = 8 * side * side;
        let (x, v_y) = (bench.data("x", pixels * inputs)?, bench.data("v_y", pixels * outputs)?);
        let (mut y, mut v_x) = (bench.device.buffer("y", v_y.len())?, bench.device.buffer("v_x", x.len())?);
        let work = Work::Flops((2 * taps * taps * pixels * inputs * outputs) as f64, "2·taps²·F·H·W·Ci·Co");
        let label = format!("{inputs}->{outputs}, {taps} taps, 8x{side}x{side}");
        let windows = format!("nn/conv2d forward {label}");
        bench.passes(&windows, work, |rec| conv2d::forward(rec, &conv, &filters, &x, Pointwise::Relu, &mut y))?;
        bench.expect(&windows, &[&matmul_fwd_windows::KERNEL, &matmul_fwd_windows_tile::KERNEL])?;
        bench.passes(&format!("nn/conv2d backward {label}"), work, |rec| {
            conv2d::backward(rec, &conv, &filters, &v_y, Some(&x), &mut v_x)
        })?;
    }
    let pool = MaxPool { frames: 8, height: 99, width: 99, channels: 64, side: 3, stride: 2 };
    let (x_len, y_len) = pool.lens();
    let x = bench.data("x", x_len)?;
    let (mut y, mut v_x) = (bench.device.buffer("y", y_len)?, bench.device.buffer("v_x", x_len)?);
    let label = "64 channels, 3 every 2, 8x99x99";
    let work = Work::Bytes((4 * (x_len + y_len)) as f64, "4·(x + y)");
    bench.passes(&format!("nn/max_pool forward {label}"), work, |rec| max_pool::forward(rec, &pool, &x, &mut y))?;
    let work = Work::Bytes((4 * (2 * x_len + y_len)) as f64, "4·(2·x + y)");
    bench.passes(&format!("nn/max_pool backward {label}"), work, |rec| max_pool::backward(rec, &pool, &x, &y, &mut v_x))
}
