//! TMSD: the identity, the exact colour map, gradients of the whole, what the network can see, sizes and files.

use guard4d_engine::base::prf::{MasterSecret, Prf, Purpose};
use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::watermark::extractor::tmsd::{Tmsd, TmsdConfig, TmsdWeights};
use guard4d_kernels::Device;
use guard4d_kernels::image::colour_map::ColourMap;
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::reference::Real;
use guard4d_kernels::reference::image::colour_map as colour_map_twin;
use guard4d_kernels::reference::nn::{axpy as axpy_twin, conv3d as conv3d_twin};
use guard4d_kernels::shape::{Accumulate, ClipShape};

use crate::support::close::{assert_close, largest};
use crate::support::gpu::{device, half_device};
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

const SHAPE: ClipShape = ClipShape { frames: 2, height: 5, width: 9 };
const MAP: ColourMap = [[1.5, -0.25, 0.75], [-3.0, 2.0, 0.5], [0.0, 4.0, -1.0]];

const ONE: ColourMap = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn fresh(config: TmsdConfig, map: ColourMap) -> TmsdWeights {
    TmsdWeights::new(config, map, &mut Prf::new(&MasterSecret::from_bytes([7; 32])).stream(Purpose::TmsdInit, 0))
}

/// The same with every layer at random, the last one too.
fn trained(config: TmsdConfig, seed: u64) -> TmsdWeights {
    let mut weights = fresh(config, MAP);
    let mut random = Random(seed);
    let last = weights.layers.len() - 1;
    for (i, layer) in weights.layers.iter_mut().enumerate() {
        let outputs = if i == last { 3 } else { config.width };
        // Values of much the same size in every layer.
        let bound = (3.0 * outputs as f64 / layer.len() as f64).sqrt();
        layer.iter_mut().for_each(|w| *w = random.uniform(-bound, bound) as f32);
    }
    weights
}

/// A clip with colours of either sign and an empty fourth channel.
fn clip(seed: u64) -> Vec<f32> {
    clip_of(SHAPE, seed)
}

fn clip_of(shape: ClipShape, seed: u64) -> Vec<f32> {
    let mut random = Random(seed);
    let pixel = |i: usize| if i % 4 == 3 { 0.0 } else { random.uniform(-1.0, 1.0) as f32 };
    (0..4 * shape.pixels()).map(pixel).collect()
}

/// R composed of the kernels' twins, in PyTorch's layout: three channels in and out, none for padding.
struct Twin<R> {
    map: [[R; 3]; 3],
    scale: R,
    layers: Vec<(conv3d_twin::Conv3d, Vec<R>)>,
}

/// What a forward pass leaves: R(x), the input of each layer, and how near a ReLU came to its corner.
struct TwinPass<R> {
    out: Vec<R>,
    inputs: Vec<Vec<R>>,
    nearest: f64,
}

fn all_of<R: Real>(values: &[f32]) -> Vec<R> {
    values.iter().map(|v| R::of(f64::from(*v))).collect()
}

/// Texels without their fourth channel, and the way back.
fn colours<R: Real>(texels: &[R]) -> Vec<R> {
    texels.chunks_exact(4).flat_map(|t| [t[0], t[1], t[2]]).collect()
}

fn texels<R: Real>(colours: &[R]) -> Vec<R> {
    colours.chunks_exact(3).flat_map(|c| [c[0], c[1], c[2], R::of(0.0)]).collect()
}

impl<R: Real> Twin<R> {
    fn new(weights: &TmsdWeights, shape: ClipShape) -> Self {
        let TmsdConfig { depth, width, scale } = weights.config;
        let layer = |(i, w): (usize, &Vec<f32>)| {
            let conv = conv3d_twin::Conv3d {
                shape: [shape.frames, shape.height, shape.width],
                in_channels: if i == 0 { 3 } else { width },
                out_channels: if i + 1 == depth { 3 } else { width },
                time: conv3d_twin::Padding::Replicate,
                space: conv3d_twin::Padding::Reflect,
            };
            (conv, all_of(w))
        };
        Self {
            map: weights.colour_map.map(|row| row.map(|m| R::of(f64::from(m)))),
            scale: R::of(f64::from(scale)),
            layers: weights.layers.iter().enumerate().map(layer).collect(),
        }
    }

    fn forward(&self, x: &[R]) -> TwinPass<R> {
        let y = colour_map_twin::forward(self.map, x);
        let (mut inputs, mut nearest) = (vec![colours(&y)], f64::INFINITY);
        for (i, (conv, weight)) in self.layers.iter().enumerate() {
            let mut next = conv.forward(&inputs[i], weight, &vec![R::of(0.0); conv.out_channels]);
            if i + 1 < self.layers.len() {
                nearest = -largest(next.iter().map(|v| -v.f64().abs()).chain([-nearest]));
                conv3d_twin::relu(&mut next);
            }
            inputs.push(next);
        }
        let delta = inputs.pop().expect("the last layer's output");
        TwinPass { out: axpy_twin::forward(self.scale, &y, &texels(&delta)), inputs, nearest }
    }

    /// dL/dx, and the gradient of each layer.
    fn backward(&self, pass: &TwinPass<R>, v_out: &[R]) -> (Vec<R>, Vec<Vec<R>>) {
        let mut v_y = colours(&axpy_twin::backward(self.scale, v_out));
        let mut v_weights = Vec::new();
        for (i, (conv, weight)) in self.layers.iter().enumerate().rev() {
            v_weights.push(conv.backward_weight(&pass.inputs[i], &v_y).0);
            v_y = conv.backward_input(&v_y, weight);
            if i > 0 {
                conv3d_twin::relu_backward(&pass.inputs[i], &mut v_y);
            }
        }
        v_weights.reverse();
        let v_mapped: Vec<R> = v_out.iter().zip(texels(&v_y)).map(|(direct, through)| *direct + through).collect();
        (colour_map_twin::backward(self.map, &v_mapped), v_weights)
    }
}

#[test]
fn gradients_of_the_whole_match_differences() {
    let shape = ClipShape { frames: 2, height: 2, width: 3 };
    let weights = trained(TmsdConfig { depth: 3, width: 4, scale: 0.5 }, 8);
    let twin = Twin::<f64>::new(&weights, shape);
    let (x, v_out): (Vec<f64>, Vec<f64>) = (all_of(&clip_of(shape, 9)), all_of(&clip_of(shape, 10)));
    let loss =
        |twin: &Twin<f64>, x: &[f64]| -> f64 { twin.forward(x).out.iter().zip(&v_out).map(|(out, v)| out * v).sum() };
    let pass = twin.forward(&x);
    let open = pass.inputs[1..].iter().flatten().filter(|v| **v > 0.0).count();
    let gates = pass.inputs[1..].iter().map(Vec::len).sum::<usize>();
    assert!(4 * open > gates && 4 * open < 3 * gates, "{open} of {gates} gates are open");
    // A hundred times the step of the differences: between the corners R is linear in each number alone.
    assert!(pass.nearest > 1e-3, "a ReLU is {} from its corner", pass.nearest);
    let (v_x, v_weights) = twin.backward(&pass, &v_out);
    let mut worst = vec![gradcheck(|x| loss(&twin, x), &x, &v_x)];
    for (i, v_weight) in v_weights.iter().enumerate() {
        let with = |w: &[f64]| {
            let mut layers = twin.layers.clone();
            layers[i].1.copy_from_slice(w);
            loss(&Twin { layers, ..twin }, &x)
        };
        worst.push(gradcheck(with, &twin.layers[i].1, v_weight));
    }
    // Only rounding of the difference remains: 1e-16 of a loss below 100, over 1e-5.
    assert!(worst.iter().all(|w| *w < 1e-8), "input and layers: {worst:?}");
}

/// Every value is a chain of sums of up to 540 products in another order: a few 2^-24 · √540 of the largest.
fn assert_follows(got: &[f32], want: &[f32]) {
    let most = largest(want.iter().map(|v| v.abs()));
    assert!(most > 0.0, "there is something to follow");
    assert_close(got, want, 1e-5 * most, 0.0);
}

#[test]
fn gradients_of_two_branches_follow_the_twin() {
    let Some(gpu) = device() else { return };
    for config in [TmsdConfig { scale: 0.5, ..TmsdConfig::default() }, TmsdConfig { depth: 4, width: 20, scale: 2.0 }] {
        let weights = trained(config, 11);
        let twin = Twin::<f32>::new(&weights, SHAPE);
        let mut tmsd = Tmsd::new(&gpu, &weights, SHAPE, Precision::F32).expect("uploads");
        let clips = [12, 14].map(|seed| (clip(seed), clip(seed + 1)));
        let inputs = clips.each_ref().map(|(x, _)| gpu.buffer_from("x", x).expect("buffer"));
        let mut passes = clips.each_ref().map(|(_, v_out)| {
            let mut pass = tmsd.pass(&gpu).expect("buffers");
            pass.v_out.write(v_out).expect("upload");
            pass
        });
        let want = clips.each_ref().map(|(x, v_out)| {
            let pass = twin.forward(x);
            // Rounding must not decide a gate.
            assert!(pass.nearest > 2e-5, "a ReLU is {} from its corner", pass.nearest);
            let (v_x, v_weights) = twin.backward(&pass, v_out);
            (pass.out, v_x, v_weights)
        });
        // As `joint` does it, and twice: the first branch takes the place of what an earlier step left.
        for _ in 0..2 {
            let mut rec = gpu.recorder().expect("recorder");
            for (x, pass) in inputs.iter().zip(&mut passes) {
                tmsd.forward(&mut rec, x, pass).expect("records");
            }
            for (pass, accumulate) in passes.iter_mut().zip([Accumulate::Overwrite, Accumulate::Add]) {
                tmsd.backward(&mut rec, pass, Some(accumulate)).expect("records");
            }
            rec.submit().expect("runs");
        }
        for (pass, (out, v_x, _)) in passes.iter().zip(&want) {
            assert_follows(&pass.out.read().expect("read"), out);
            assert_follows(&pass.v_x.read().expect("read"), v_x);
        }
        let v_weights = tmsd.weight_gradients().expect("reads");
        assert_eq!(v_weights.len(), config.depth);
        for (i, v_weight) in v_weights.iter().enumerate() {
            let sum: Vec<f32> = want[0].2[i].iter().zip(&want[1].2[i]).map(|(a, b)| a + b).collect();
            assert_follows(v_weight, &sum);
        }
    }
}

/// R(x), and dL/dx for dL/dR(x) = `v_out`.
fn both_ways(device: &Device, weights: &TmsdWeights, x: &[f32], v_out: &[f32]) -> (Vec<f32>, Vec<f32>) {
    both_ways_in(Precision::F32, device, weights, (x, v_out))
}

/// The same in this precision.
fn both_ways_in(
    precision: Precision,
    device: &Device,
    weights: &TmsdWeights,
    (x, v_out): (&[f32], &[f32]),
) -> (Vec<f32>, Vec<f32>) {
    let mut tmsd = Tmsd::new(device, weights, SHAPE, precision).expect("uploads");
    let mut pass = tmsd.pass(device).expect("buffers");
    pass.v_out.write(v_out).expect("upload");
    let x = device.buffer_from("x", x).expect("buffer");
    let mut rec = device.recorder().expect("recorder");
    tmsd.forward(&mut rec, &x, &mut pass).expect("records");
    tmsd.backward(&mut rec, &mut pass, None).expect("records");
    rec.submit().expect("runs");
    (pass.out.read().expect("read"), pass.v_x.read().expect("read"))
}

/// `map` at every pixel; the fourth channel stays 0.
fn mapped(map: &ColourMap, x: &[f32]) -> Vec<f32> {
    let row = |row: &[f32; 3], p: &[f32]| row.iter().zip(p).map(|(m, v)| f64::from(*m) * f64::from(*v)).sum::<f64>();
    x.chunks_exact(4).flat_map(|p| [row(&map[0], p), row(&map[1], p), row(&map[2], p), 0.0].map(|v| v as f32)).collect()
}

#[test]
fn fresh_network_is_the_identity_bit_for_bit() {
    let Some(gpu) = device() else { return };
    let weights = fresh(TmsdConfig::default(), ONE);
    assert!(weights.layers[0].iter().any(|w| *w != 0.0), "inner layers start at random");
    let (x, v_out) = (clip(1), clip(2));
    let (out, v_x) = both_ways(&gpu, &weights, &x, &v_out);
    assert_close(&out, &x, 0.0, 0.0);
    assert_close(&v_x, &v_out, 0.0, 0.0);
}

#[test]
fn fresh_network_is_the_colour_map_alone() {
    let Some(gpu) = device() else { return };
    let configs = [
        TmsdConfig::colour_map_only(),
        TmsdConfig::default(),
        TmsdConfig { depth: 2, width: 4, scale: 0.25 },
        TmsdConfig { depth: 4, width: 20, scale: 2.0 },
    ];
    for config in configs {
        let weights = fresh(config, MAP);
        let (x, v_out) = (clip(3), clip(4));
        let (out, v_x) = both_ways(&gpu, &weights, &x, &v_out);
        // Three products of at most 4 and their sum: a few roundings of values below 8.
        assert_close(&out, &mapped(&MAP, &x), 4e-6, 0.0);
        let transposed = std::array::from_fn(|i| std::array::from_fn(|j| MAP[j][i]));
        assert_close(&v_x, &mapped(&transposed, &v_out), 4e-6, 0.0);
    }
}

#[test]
fn half_precision_moves_the_network_by_its_rounding_alone() {
    let Some(gpu) = half_device() else { return };
    let weights = trained(TmsdConfig::default(), 12);
    let (x, v_out) = (clip(5), clip(6));
    let [floats, halves] = [Precision::F32, Precision::Half].map(|p| both_ways_in(p, &gpu, &weights, (&x, &v_out)));
    let y = mapped(&weights.colour_map, &x);
    let transposed = std::array::from_fn(|i| std::array::from_fn(|j| weights.colour_map[j][i]));
    let v_y = mapped(&transposed, &v_out);
    for (got, want, start) in [(&halves.0, &floats.0, &y), (&halves.1, &floats.1, &v_y)] {
        let length = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f32>().sqrt();
        // Of what the network adds to the colour map. Three layers round two factors each by at most 2^-11, but a sum
        // below that falls to the other side of a ReLU, with its whole gradient: one of some hundred.
        let error = length(got, want) / length(want, start);
        assert!(error > 1e-6 && error < 1e-1, "{error} of the length: rounded, and no more");
    }
}

#[test]
fn network_sees_mapped_colours_only() {
    let Some(gpu) = device() else { return };
    let mut weights = fresh(TmsdConfig::default(), ONE);
    for (i, w) in weights.layers.iter_mut().flatten().enumerate() {
        *w += 0.1 * (i as f32).sin();
    }
    let (x, v_out) = (clip(5), clip(6));
    let (plain, _) = both_ways(&gpu, &weights, &x, &v_out);
    assert!(plain.iter().zip(&x).any(|(a, b)| (a - b).abs() > 0.01), "the network does something");
    // Red becomes blue and green is dropped: a clip that differs in green only must read the same.
    weights.colour_map = [[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]];
    let greener: Vec<f32> = x.iter().enumerate().map(|(i, v)| if i % 4 == 1 { v + 0.5 } else { *v }).collect();
    let (one, v_x) = both_ways(&gpu, &weights, &x, &v_out);
    assert_close(&one, &both_ways(&gpu, &weights, &greener, &v_out).0, 0.0, 0.0);
    assert!(one.iter().any(|v| v.abs() > 0.01), "red still comes through");
    let green_and_blue = v_x.chunks_exact(4).flat_map(|p| [p[1], p[2]]);
    assert!(largest(green_and_blue.map(f32::abs)) <= 0.0, "no gradient to what is dropped");
}

#[test]
fn device_gives_back_the_weights_it_got() {
    let Some(gpu) = device() else { return };
    let weights = fresh(TmsdConfig::default(), MAP);
    let tmsd = Tmsd::new(&gpu, &weights, SHAPE, Precision::F32).expect("uploads");
    assert_eq!(tmsd.weights().expect("reads"), weights, "packing is undone");
}

#[test]
fn file_gives_back_what_was_stored_and_names_what_is_wrong() {
    let weights = fresh(TmsdConfig { depth: 4, width: 12, scale: 0.1 }, MAP);
    let mut file = TensorFile::default();
    assert_eq!(TmsdWeights::load(&file).expect("loads"), None, "a file without a network");
    weights.store(&mut file);
    assert_eq!(TmsdWeights::load(&file).expect("loads"), Some(weights), "round trip");
    let layer = file.tensors.remove("tmsd.2.weight").expect("it was stored");
    let error = TmsdWeights::load(&file).expect_err("a tensor is gone").to_string();
    assert!(error.contains("tmsd.2.weight"), "{error}");
    file.tensors.insert("tmsd.2.weight".to_owned(), layer);
    file.meta.insert("tmsd".to_owned(), r#"{"depth":4,"width":13,"scale":0.1}"#.to_owned());
    assert!(TmsdWeights::load(&file).is_err(), "an impossible width");
}

#[test]
fn impossible_sizes_are_refused_by_name() {
    let fine = TmsdConfig::default();
    fine.validate().expect("the default is possible");
    let bad = [
        ("depth", TmsdConfig { depth: 1, ..fine }),
        ("depth", TmsdConfig { depth: 9, ..fine }),
        ("width", TmsdConfig { width: 0, ..fine }),
        ("width", TmsdConfig { width: 18, ..fine }),
        ("width", TmsdConfig { width: 68, ..fine }),
        ("scale", TmsdConfig { scale: 0.0, ..fine }),
        ("scale", TmsdConfig { scale: -1.0, ..fine }),
        ("scale", TmsdConfig { scale: f32::NAN, ..fine }),
        ("scale", TmsdConfig { scale: f32::INFINITY, ..fine }),
    ];
    for (field, config) in bad {
        let error = config.validate().expect_err("an impossible size");
        assert!(matches!(&error, EngineError::Usage { what, .. } if what.contains(field)), "{error}");
    }
}
