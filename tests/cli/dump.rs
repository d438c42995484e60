//! `guard4d dump` against the goldens of other implementations.

use std::path::Path;

use guard4d_engine::tensor_file::{Tensor, TensorFile};

use super::{guard4d, put, scratch};
use crate::support::close::{assert_close, cosine, worst_ratio};
use crate::support::gpu::device;
use crate::support::{repo, shared};

fn read(path: &Path) -> TensorFile {
    TensorFile::read(path).expect("the dump is a safetensors file")
}

/// Tensor `name` of `file` in the shape that `like` has under `other`.
fn same_shape<'a>(file: &'a TensorFile, name: &str, like: &'a TensorFile, other: &str) -> (&'a [f32], &'a [f32]) {
    let shape = &like.get(other).expect("a tensor of the golden").shape;
    (file.floats(name, shape).expect("the golden's shape"), like.floats(other, shape).expect("floats"))
}

#[test]
fn deform_matches_the_goldens() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    for (name, key, time) in
        [("dnerf_like", "t0.37", "0.37"), ("dynerf_like", "t1.0", "1"), ("deep_applyrot", "t0.5", "0.5")]
    {
        let Some(model) = shared(&format!("data/golden/{name}")) else { return };
        let out = folder.path().join(format!("{name}.safetensors"));
        guard4d(&[&"dump", &"deform", &model, &"--time", &time, &"--out", &out]).done();
        let (got, want) = (read(&out), read(&model.join("expected.safetensors")));
        let tensors = ["feat", "hidden", "xyz", "scale", "rot", "opacity", "sh"];
        assert_eq!(got.tensors.len(), tensors.len(), "nothing else is written");
        for tensor in tensors {
            let (got, want) = same_shape(&got, tensor, &want, &format!("{key}.{tensor}"));
            // The goldens' own tolerance for f32.
            assert_close(got, want, 1e-5, 0.0);
        }
    }
}

#[test]
fn render_matches_the_reference_picture_and_gradient() {
    let (Some(golden), Some(ply)) = (shared("data/golden/raster_fruit"), shared("data/static/fruit_drops_minimal.ply"))
    else {
        return;
    };
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("view.safetensors");
    let (camera, expected) = (golden.join("camera.json"), golden.join("expected.safetensors"));
    guard4d(&[&"dump", &"render", &ply, &"--camera", &camera, &"--v-image", &expected, &"--out", &out]).done();
    let (got, want) = (read(&out), read(&expected));
    for (name, channels) in [("image", 3), ("final_T", 1)] {
        let (got, want) = same_shape(&got, name, &want, name);
        let squares: f64 = got.iter().zip(want).map(|(g, w)| f64::from(g - w).powi(2)).sum();
        let psnr = -10.0 * (squares / got.len() as f64).log10();
        // Alpha and stop decisions flip between f32 and f64 in a few pixels (formats, tolerances for goldens).
        assert!(psnr > 55.0, "{name}: PSNR {psnr} dB");
        let pixels = got.chunks(channels).zip(want.chunks(channels));
        let off = pixels.filter(|(g, w)| worst_ratio(g, w, 1e-4, 0.0) > 1.0).count();
        assert!(off * channels * 1000 <= got.len(), "{name}: {off} pixels are off by more than 1e-4");
    }
    let (got, want) = same_shape(&got, "dL_dsh", &want, "dL_dsh");
    assert!(cosine(got, want) > 0.9999, "gradient: cosine {}", cosine(got, want));
}

#[test]
fn clip_matches_transformers() {
    let Some(input) = shared("weights/mini-clip/fixtures/reference.safetensors") else { return };
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("clip.safetensors");
    guard4d(&[&"dump", &"clip", &"--clip", &"mini", &"--input", &input, &"--out", &out]).done();
    let (got, want) = (read(&out), read(&input));
    for name in ["image_embeds", "text_embeds"] {
        let (got, want) = same_shape(&got, name, &want, name);
        for (got, want) in got.chunks(512).zip(want.chunks(512)) {
            let length = want.iter().map(|v| v * v).sum::<f32>().sqrt();
            let unit: Vec<f32> = want.iter().map(|v| v / length).collect();
            // 2e-4 of a feature's length is the agreement asked for.
            assert_close(got, &unit, 2e-4, 0.0);
        }
    }
    let (got, want) = same_shape(&got, "v_pixel_values", &want, "v_pixel_values");
    for (got, want) in got.chunks(3 * 64 * 64).zip(want.chunks(3 * 64 * 64)) {
        assert!(cosine(got, want) > 0.9999, "gradient: cosine {}", cosine(got, want));
    }
}

#[test]
fn conv3d_and_ssim_match_pytorch() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let golden = repo("tests/golden/conv3d.safetensors");
    let want = read(&golden);
    for border in ["zero", "clip"] {
        let out = folder.path().join(format!("{border}.safetensors"));
        guard4d(&[&"dump", &"conv3d", &"--border", &border, &"--input", &golden, &"--out", &out]).done();
        let got = read(&out);
        for name in ["y", "v_x", "v_weight", "v_bias"] {
            let (got, want) = same_shape(&got, name, &want, &format!("{border}.{name}"));
            // Sums of some hundred products below 1 in another order.
            assert_close(got, want, 1e-5, 1e-5);
        }
    }
    let golden = repo("tests/golden/ssim.safetensors");
    let out = folder.path().join("ssim.safetensors");
    guard4d(&[&"dump", &"ssim", &"--input", &golden, &"--out", &out]).done();
    let (got, want) = (read(&out), read(&golden));
    let (value, reference) = same_shape(&got, "value", &want, "value");
    // Variances are differences of f32 means near 1, divided by about C2 = 9e-4: errors of 1e-7 become 1e-4.
    assert_close(value, reference, 1e-4, 0.0);
    let (v_x, reference) = same_shape(&got, "v_x", &want, "v_x");
    assert!(cosine(v_x, reference) > 0.999_99, "gradient: cosine {}", cosine(v_x, reference));
}

/// A 1x1x1 convolution's worth of pixels with one input and one output channel, as no device layout has them.
#[test]
fn conv3d_takes_any_number_of_channels() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let mut file = TensorFile::default();
    let mut weight = vec![0.0; 27];
    weight[13] = 2.0;
    let mut add = |name: &str, shape: &[usize], values: Vec<f32>| {
        file.tensors.insert(name.to_owned(), Tensor::f32(shape, values));
    };
    add("x", &[1, 2, 2, 1], vec![1.0, 2.0, 3.0, 4.0]);
    add("weight", &[1, 1, 3, 3, 3], weight);
    let input = put(folder.path(), "in.safetensors", &file.to_bytes().expect("serialises"));
    let out = folder.path().join("out.safetensors");
    guard4d(&[&"dump", &"conv3d", &"--input", &input, &"--out", &out]).done();
    assert_eq!(read(&out).floats("y", &[1, 2, 2, 1]).expect("y"), [2.0, 4.0, 6.0, 8.0], "doubled");
}

#[test]
fn wrong_inputs_are_told_and_leave_nothing() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("out.safetensors");
    let mut file = TensorFile::default();
    file.tensors.insert("pixel_values".to_owned(), Tensor::f32(&[1, 3, 2, 2], vec![0.0; 12]));
    let input = put(folder.path(), "in.safetensors", &file.to_bytes().expect("serialises"));
    guard4d(&[&"dump", &"clip", &"--input", &input, &"--out", &out])
        .refused(65, &["in.safetensors", "pixel_values", "[1, 3, 2, 2]", "[B,3,64,64]"]);
    guard4d(&[&"dump", &"ssim", &"--input", &input, &"--out", &out]).refused(65, &["in.safetensors: x: nothing"]);
    let nowhere = folder.path().join("nowhere.safetensors");
    guard4d(&[&"dump", &"ssim", &"--input", &nowhere, &"--out", &out]).refused(66, &["nowhere.safetensors: not found"]);
    let camera = put(folder.path(), "camera.json", b"{\"frames\": []}");
    guard4d(&[&"dump", &"render", &nowhere, &"--camera", &camera, &"--out", &out]).refused(65, &["camera.json"]);
    if let Some(model) = shared("data/golden/dnerf_like") {
        guard4d(&[&"dump", &"deform", &model, &"--time", &"1.5", &"--out", &out]).refused(2, &["time: 1.5", "0 to 1"]);
    }
    assert_eq!(super::names(folder.path()), ["camera.json", "in.safetensors"], "no output and no partial output");
}
