//! `guard4d lab dump` against the goldens of other implementations.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use guard4d_engine::base::tensor_file::{Tensor, TensorFile};
use serde_json::json;

use super::{guard4d, put, scratch};
use crate::support::close::{assert_close, assert_features_close, cosine, worst_ratio};
use crate::support::gpu::device;
use crate::support::raster::{self, RasterCase};
use crate::support::{golden, repo, shared};

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
    for name in ["dnerf_like", "dynerf_like", "deep_applyrot"] {
        let model = golden::model(name);
        let want = read(&model.join("expected.safetensors"));
        for time in ["0.0", "0.37", "0.5", "1.0"] {
            let out = folder.path().join(format!("{name}.{time}.safetensors"));
            guard4d(&[&"lab", &"dump", &"deform", &model, &"--time", &time, &"--out", &out]).done();
            let got = read(&out);
            let tensors = ["feat", "hidden", "xyz", "scale", "rot", "opacity", "sh"];
            assert_eq!(got.tensors.len(), tensors.len(), "nothing else is written");
            for tensor in tensors {
                let (got, want) = same_shape(&got, tensor, &want, &format!("t{time}.{tensor}"));
                // The goldens' own tolerance for f32.
                assert_close(got, want, 1e-5, 0.0);
            }
        }
    }
}

#[test]
fn render_matches_the_reference_picture_and_gradient() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("view.safetensors");
    for RasterCase { ply, camera, expected, tolerance, strays_per_mille } in raster::cases(folder.path()) {
        let run = guard4d(&[
            &"lab",
            &"dump",
            &"render",
            &ply,
            &"--camera",
            &camera,
            &"--v-image",
            &expected,
            &"--out",
            &out,
            &"-w",
        ]);
        run.done();
        let (got, want) = (read(&out), read(&expected));
        for (name, channels) in [("image", 3), ("final_T", 1)] {
            let (got, want) = same_shape(&got, name, &want, name);
            let squares: f64 = got.iter().zip(want).map(|(g, w)| f64::from(g - w).powi(2)).sum();
            let psnr = -10.0 * (squares / got.len() as f64).log10();
            assert!(psnr > 55.0, "{name}: PSNR {psnr} dB");
            let pixels = got.chunks(channels).zip(want.chunks(channels));
            let off = pixels.filter(|(g, w)| worst_ratio(g, w, tolerance, 0.0) > 1.0).count();
            let allowed = got.len() / channels * strays_per_mille;
            assert!(off * 1000 <= allowed, "{name}: {off} pixels are off by more than {tolerance}");
        }
        let (got, want) = same_shape(&got, "dL_dsh", &want, "dL_dsh");
        // A few flipped decisions turn the gradient by about 1e-5.
        assert!(cosine(got, want) > 0.9999, "gradient: cosine {}", cosine(got, want));
    }
}

/// One camera that sees the golden models; with a time where one is given.
fn camera_file(folder: &Path, name: &str, time: Option<f32>) -> PathBuf {
    let mut camera = json!({
        "width": 40, "height": 24, "fx": 30.0, "fy": 30.0,
        "world_to_camera_row_major": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]],
    });
    if let Some(time) = time {
        camera["time"] = json!(time);
    }
    put(folder, name, camera.to_string().as_bytes())
}

#[test]
fn render_takes_the_time_of_the_flag_before_the_cameras() {
    if device().is_none() {
        return;
    }
    let (folder, model) = (scratch(), golden::model("dnerf_like"));
    let picture = |camera: &PathBuf, flag: Option<&str>| {
        let out = folder.path().join("view.safetensors");
        let mut args: Vec<&dyn AsRef<OsStr>> =
            vec![&"lab", &"dump", &"render", &model, &"--camera", camera, &"--out", &out, &"-w"];
        let time = flag.unwrap_or_default();
        if flag.is_some() {
            args.extend([&"--time" as &dyn AsRef<OsStr>, &time]);
        }
        guard4d(&args).done();
        read(&out).floats("image", &[24, 40, 3]).expect("a picture").to_vec()
    };
    let without = camera_file(folder.path(), "without.json", None);
    let late = camera_file(folder.path(), "late.json", Some(1.0));
    let (start, end) = (picture(&without, None), picture(&late, None));
    assert!(start != end && start.iter().all(|v| v.is_finite()), "the model moves within this camera's view");
    assert_eq!(picture(&without, Some("0")), start, "without any time it is 0");
    assert_eq!(picture(&without, Some("1")), end, "the flag's time");
    assert_eq!(picture(&late, Some("0")), start, "the flag counts more than the camera's file");
    let out = folder.path().join("never.safetensors");
    guard4d(&[&"lab", &"dump", &"render", &model, &"--camera", &late, &"--time", &"1.5", &"--out", &out])
        .refused(2, &["time: 1.5", "0 to 1"]);
    assert!(!out.exists(), "no output");
}

#[test]
fn render_refuses_a_gradient_of_another_shape() {
    if device().is_none() {
        return;
    }
    let (folder, model) = (scratch(), golden::model("dnerf_like"));
    let camera = camera_file(folder.path(), "camera.json", None);
    let out = folder.path().join("out.safetensors");
    let refused = |tensor: &str, shape: &[usize], words: &[&str]| {
        let mut file = TensorFile::default();
        file.tensors.insert(tensor.to_owned(), Tensor::f32(shape, vec![0.0; shape.iter().product()]));
        let v_image = put(folder.path(), "v_image.safetensors", &file.to_bytes().expect("serialises"));
        let run = guard4d(&[
            &"lab",
            &"dump",
            &"render",
            &model,
            &"--camera",
            &camera,
            &"--v-image",
            &v_image,
            &"--out",
            &out,
        ]);
        run.refused(65, words);
        assert!(!out.exists(), "no output");
    };
    // Width before height, a fourth channel, a missing axis, another name.
    let expected = "expected f32 [24, 40, 3]";
    refused("dL_dimage", &[40, 24, 3], &["v_image.safetensors: dL_dimage: f32 [40, 24, 3]", expected]);
    refused("dL_dimage", &[24, 40, 4], &["dL_dimage: f32 [24, 40, 4]", expected]);
    refused("dL_dimage", &[24, 120], &["dL_dimage: f32 [24, 120]", expected]);
    refused("v_image", &[24, 40, 3], &["v_image.safetensors: dL_dimage: nothing"]);
}

/// Floats of a feature of the built-in CLIP.
const FEATURE: usize = 512;

/// Features divided by their lengths.
fn unit_rows(features: &[f32]) -> Vec<f32> {
    let unit = |row: &[f32]| {
        let length = row.iter().map(|v| v * v).sum::<f32>().sqrt();
        row.iter().map(|v| v / length).collect::<Vec<_>>()
    };
    features.chunks(FEATURE).flat_map(unit).collect()
}

#[test]
fn clip_matches_transformers() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("clip.safetensors");
    let real = shared("weights/mini-clip/fixtures/reference.safetensors");
    for input in [Some(repo("tests/golden/clip_mini.safetensors")), real].into_iter().flatten() {
        guard4d(&[&"lab", &"dump", &"clip", &"--clip", &"mini", &"--input", &input, &"--out", &out, &"-w"]).done();
        let (got, want) = (read(&out), read(&input));
        for name in ["image_embeds", "text_embeds"] {
            let (got, want) = same_shape(&got, name, &want, name);
            assert_features_close(got, &unit_rows(want), FEATURE);
        }
        let (got, want) = same_shape(&got, "v_pixel_values", &want, "v_pixel_values");
        for (got, want) in got.chunks(3 * 64 * 64).zip(want.chunks(3 * 64 * 64)) {
            assert!(cosine(got, want) > 0.9999, "gradient: cosine {}", cosine(got, want));
        }
    }
}

#[test]
fn clip_takes_images_or_texts_alone() {
    if device().is_none() {
        return;
    }
    let (folder, golden) = (scratch(), read(&repo("tests/golden/clip_mini.safetensors")));
    for (name, gives) in [("pixel_values", "image_embeds"), ("input_ids", "text_embeds")] {
        let tensor = golden.get(name).expect("a tensor of the golden").clone();
        let alone = TensorFile { tensors: [(name.to_owned(), tensor)].into(), ..TensorFile::default() };
        let input = put(folder.path(), name, &alone.to_bytes().expect("serialises"));
        let out = folder.path().join(gives);
        guard4d(&[&"lab", &"dump", &"clip", &"--input", &input, &"--out", &out]).done();
        let got = read(&out);
        assert_eq!(got.tensors.keys().collect::<Vec<_>>(), [gives], "no features of what was not given, no gradient");
        let (got, want) = same_shape(&got, gives, &golden, gives);
        assert_features_close(got, &unit_rows(want), FEATURE);
    }
}

#[test]
fn clip_takes_a_folder_as_checkpoint() {
    if device().is_none() {
        return;
    }
    let (folder, input) = (scratch(), repo("tests/golden/clip_mini.safetensors"));
    let dump = |checkpoint: &dyn AsRef<OsStr>, name: &str| {
        let out = folder.path().join(name);
        guard4d(&[&"lab", &"dump", &"clip", &"--clip", checkpoint, &"--input", &input, &"--out", &out]).done();
        std::fs::read(out).expect("it was written a moment ago")
    };
    let copied = dump(&repo("engine/assets/mini-clip"), "folder.safetensors");
    assert!(copied == dump(&"mini", "mini.safetensors"), "the folder of the built-in checkpoint gives the same bytes");
    let out = folder.path().join("out.safetensors");
    let nowhere = folder.path().join("nowhere");
    guard4d(&[&"lab", &"dump", &"clip", &"--clip", &nowhere, &"--input", &input, &"--out", &out])
        .refused(66, &["nowhere"]);
    put(&nowhere, "config.json", b"no JSON");
    guard4d(&[&"lab", &"dump", &"clip", &"--clip", &nowhere, &"--input", &input, &"--out", &out])
        .refused(65, &["config.json"]);
    assert!(!out.exists(), "no output");
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
        guard4d(&[&"lab", &"dump", &"conv3d", &"--border", &border, &"--input", &golden, &"--out", &out]).done();
        let got = read(&out);
        for name in ["y", "v_x", "v_weight", "v_bias"] {
            let (got, want) = same_shape(&got, name, &want, &format!("{border}.{name}"));
            // Sums of some hundred products below 1 in another order.
            assert_close(got, want, 1e-5, 1e-5);
        }
    }
    let golden = repo("tests/golden/ssim.safetensors");
    let out = folder.path().join("ssim.safetensors");
    guard4d(&[&"lab", &"dump", &"ssim", &"--input", &golden, &"--out", &out]).done();
    let (got, want) = (read(&out), read(&golden));
    let (value, reference) = same_shape(&got, "value", &want, "value");
    // Variances are differences of f32 means near 1, divided by about C2 = 9e-4: errors of 1e-7 become 1e-4.
    assert_close(value, reference, 1e-4, 0.0);
    let (v_x, reference) = same_shape(&got, "v_x", &want, "v_x");
    assert!(cosine(v_x, reference) > 0.999_99, "gradient: cosine {}", cosine(v_x, reference));
}

#[test]
fn adam_matches_pytorch() {
    if device().is_none() {
        return;
    }
    let (folder, golden) = (scratch(), repo("tests/golden/adam.safetensors"));
    let out = folder.path().join("adam.safetensors");
    guard4d(&[&"lab", &"dump", &"adam", &"--input", &golden, &"--out", &out]).done();
    let (got, want) = (read(&out), read(&golden));
    for name in ["history", "exp_avg", "exp_avg_sq"] {
        let (got, want) = same_shape(&got, name, &want, name);
        // A few roundings of values near 1 per step.
        assert_close(got, want, 1e-6, 1e-6);
    }
    let mut file = want;
    file.tensors.insert("grads".to_owned(), Tensor::f32(&[2, 99], vec![0.0; 198]));
    let input = put(folder.path(), "in.safetensors", &file.to_bytes().expect("serialises"));
    guard4d(&[&"lab", &"dump", &"adam", &"--input", &input, &"--out", &out, &"-w"])
        .refused(65, &["in.safetensors: grads: f32 [2, 99]", "expected f32 [2, 100]"]);
}

#[test]
fn resize_matches_pytorch() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let out = folder.path().join("resize.safetensors");
    let want = read(&repo("tests/golden/resize.safetensors"));
    let input = |case: &str, names: &[&str]| {
        let tensor = |name: &&str| ((*name).to_owned(), want.get(&format!("{case}.{name}")).expect("a tensor").clone());
        let file = TensorFile { tensors: names.iter().map(tensor).collect(), ..TensorFile::default() };
        put(folder.path(), "in.safetensors", &file.to_bytes().expect("serialises"))
    };
    for (case, size) in [("down", "8x11"), ("up", "12x16"), ("one", "1x1"), ("mixed", "13x7")] {
        let both = input(case, &["x", "v_y"]);
        guard4d(&[&"lab", &"dump", &"resize", &"--size", &size, &"--input", &both, &"--out", &out, &"-w"]).done();
        let got = read(&out);
        // Weights are f32 sums of up to 14 triangle values on either side: about 1e-6.
        for (name, tolerance) in [("y", 2e-6), ("v_x", 4e-6)] {
            let (got, want) = same_shape(&got, name, &want, &format!("{case}.{name}"));
            assert_close(got, want, tolerance, 1e-6);
        }
    }
    let alone = input("down", &["x"]);
    guard4d(&[&"lab", &"dump", &"resize", &"--size", &"3x2", &"--input", &alone, &"--out", &out, &"-w"]).done();
    let got = read(&out);
    assert_eq!(got.tensors.keys().collect::<Vec<_>>(), ["y"], "no gradient was asked for");
    assert_eq!(got.get("y").expect("there").shape, [2, 2, 3, 4], "WIDTHxHEIGHT");
    let both = input("down", &["x", "v_y"]);
    guard4d(&[&"lab", &"dump", &"resize", &"--size", &"11x8", &"--input", &both, &"--out", &out, &"-w"])
        .refused(65, &["in.safetensors: v_y: f32 [2, 11, 8, 4]", "expected f32 [2, 8, 11, 4]"]);
    guard4d(&[&"lab", &"dump", &"resize", &"--size", &"0x8", &"--input", &both, &"--out", &out])
        .refused(2, &["from 1 to 8192"]);
}

/// The fourth channel of a pixel is read by nothing, and need not be there.
#[test]
fn resize_takes_three_channels() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let mut file = TensorFile::default();
    file.tensors.insert("x".to_owned(), Tensor::f32(&[1, 1, 2, 3], vec![1.0, 2.0, 3.0, 5.0, 6.0, 7.0]));
    let input = put(folder.path(), "in.safetensors", &file.to_bytes().expect("serialises"));
    let out = folder.path().join("out.safetensors");
    guard4d(&[&"lab", &"dump", &"resize", &"--size", &"2x1", &"--input", &input, &"--out", &out]).done();
    let got = read(&out);
    assert_eq!(got.floats("y", &[1, 1, 2, 3]).expect("y"), [1.0, 2.0, 3.0, 5.0, 6.0, 7.0], "the same size is a copy");
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
    guard4d(&[&"lab", &"dump", &"conv3d", &"--input", &input, &"--out", &out]).done();
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
    guard4d(&[&"lab", &"dump", &"clip", &"--input", &input, &"--out", &out])
        .refused(65, &["in.safetensors", "pixel_values", "[1, 3, 2, 2]", "[B,3,64,64]"]);
    guard4d(&[&"lab", &"dump", &"ssim", &"--input", &input, &"--out", &out])
        .refused(65, &["in.safetensors: x: nothing"]);
    let nowhere = folder.path().join("nowhere.safetensors");
    guard4d(&[&"lab", &"dump", &"ssim", &"--input", &nowhere, &"--out", &out])
        .refused(66, &["nowhere.safetensors: not found"]);
    let camera = put(folder.path(), "camera.json", b"{\"frames\": []}");
    guard4d(&[&"lab", &"dump", &"render", &nowhere, &"--camera", &camera, &"--out", &out])
        .refused(65, &["camera.json"]);
    let model = golden::model("dnerf_like");
    guard4d(&[&"lab", &"dump", &"deform", &model, &"--time", &"1.5", &"--out", &out])
        .refused(2, &["time: 1.5", "0 to 1"]);
    assert_eq!(super::names(folder.path()), ["camera.json", "in.safetensors"], "no output and no partial output");
}
