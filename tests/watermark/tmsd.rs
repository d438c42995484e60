//! TMSD: the identity, the exact colour map and its gradient, what the network can see, sizes and files.

use guard4d_engine::EngineError;
use guard4d_engine::tensor_file::TensorFile;
use guard4d_engine::watermark::prf::{MasterSecret, Prf, Purpose};
use guard4d_engine::watermark::tmsd::{Tmsd, TmsdConfig, TmsdWeights};
use guard4d_kernels::Device;
use guard4d_kernels::image::colour_map::ColourMap;
use guard4d_kernels::shape::ClipShape;

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::random::Random;

const SHAPE: ClipShape = ClipShape { frames: 2, height: 5, width: 9 };
const MAP: ColourMap = [[1.5, -0.25, 0.75], [-3.0, 2.0, 0.5], [0.0, 4.0, -1.0]];

const ONE: ColourMap = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn fresh(config: TmsdConfig, map: ColourMap) -> TmsdWeights {
    TmsdWeights::new(config, map, &mut Prf::new(&MasterSecret::from_bytes([7; 32])).stream(Purpose::TmsdInit, 0))
}

/// A clip with colours of either sign and an empty fourth channel.
fn clip(seed: u64) -> Vec<f32> {
    let mut random = Random(seed);
    let pixel = |i: usize| if i % 4 == 3 { 0.0 } else { random.uniform(-1.0, 1.0) as f32 };
    (0..4 * SHAPE.pixels()).map(pixel).collect()
}

/// R(x), and dL/dx for dL/dR(x) = `v_out`.
fn both_ways(device: &Device, weights: &TmsdWeights, x: &[f32], v_out: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let mut tmsd = Tmsd::new(device, weights, SHAPE).expect("uploads");
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
    assert!(green_and_blue.map(f32::abs).fold(0.0, f32::max) <= 0.0, "no gradient to what is dropped");
}

#[test]
fn device_gives_back_the_weights_it_got() {
    let Some(gpu) = device() else { return };
    let weights = fresh(TmsdConfig::default(), MAP);
    let tmsd = Tmsd::new(&gpu, &weights, SHAPE).expect("uploads");
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
