//! The miniature CLIP against transformers' outputs and gradients: for the golden file's random pictures and texts, and
//! for real ones where the test material is.

use guard4d_engine::base::tensor_file::TensorFile;
use guard4d_engine::networks::clip::{ClipModel, ClipSource, Precision, TowerPurpose, VisionTower, VisionWorkspace};
use guard4d_kernels::Buffer;

use super::super::{length, padded_texts, pixels_of, token_ids};
use crate::support::close::{assert_close, assert_features_close, cosine, largest, relative_distance};
use crate::support::gpu::{Gpu, device, half_device, own_device};
use crate::support::{repo, shared};

fn fixtures() -> Option<TensorFile> {
    let path = shared("weights/mini-clip/fixtures/reference.safetensors")?;
    Some(TensorFile::read(&path).expect("the fixtures can be read"))
}

/// What every clone has: two pictures, two texts.
fn golden() -> TensorFile {
    TensorFile::read(&repo("tests/golden/clip_mini.safetensors")).expect("golden values")
}

fn mini(gpu: &Gpu) -> ClipModel {
    ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete")
}

/// Rows divided by their lengths.
fn unit_rows(x: &[f32], width: usize) -> Vec<f32> {
    x.chunks_exact(width)
        .flat_map(|row| {
            let norm = length(row);
            row.iter().map(move |v| v / norm)
        })
        .collect()
}

/// Floats of a picture.
const PICTURE: usize = 3 * 64 * 64;

#[test]
fn image_features_match_transformers() {
    let Some(gpu) = device() else { return };
    let tower = mini(&gpu).vision(TowerPurpose::Features).expect("tower");
    for (file, count) in [(Some(golden()), 2), (fixtures(), 24)] {
        let Some(file) = file else { continue };
        let planes = file.floats("pixel_values", &[count, 3, 64, 64]).expect("pictures");
        let pixels = gpu.buffer_from("pixels", &pixels_of(planes, 64)).expect("buffer");
        let mut ws = tower.workspace(count).expect("workspace");
        let mut rec = gpu.recorder().expect("recorder");
        tower.forward(&mut rec, &pixels, &mut ws).expect("records");
        rec.submit().expect("runs");
        let want = file.floats("image_embeds", &[count, 512]).expect("features");
        assert_features_close(&ws.features.read().expect("read"), &unit_rows(want, 512), 512);
    }
}

#[test]
fn half_precision_moves_features_and_gradients_by_its_rounding_alone() {
    let Some(gpu) = half_device() else { return };
    let file = golden();
    let planes = file.floats("pixel_values", &[2, 3, 64, 64]).expect("pictures");
    let v_features = file.floats("v_image_embeds", &[2, 512]).expect("a gradient");
    // A gradient that no 16-bit float holds must come through as well as one that it does.
    let tiny = 2.0f32.powi(-30);
    let cases = [(Precision::F32, 1.0), (Precision::Half, 1.0), (Precision::Half, tiny)];
    let [(features, v_pixels), (rounded, v_rounded), (_, v_tiny)] = cases.map(|(precision, factor)| {
        let tower = mini(&gpu).in_precision(precision).vision(TowerPurpose::InputGradient).expect("tower");
        let pixels = gpu.buffer_from("pixels", &pixels_of(planes, 64)).expect("buffer");
        let v_features: Vec<f32> = v_features.iter().map(|v| v * factor).collect();
        let v_features = gpu.buffer_from("v_features", &v_features).expect("buffer");
        let mut v_pixels = gpu.buffer_from("v_pixels", &vec![f32::NAN; 2 * 64 * 64 * 4]).expect("buffer");
        let mut ws = tower.workspace(2).expect("workspace");
        let mut rec = gpu.recorder().expect("recorder");
        tower.forward(&mut rec, &pixels, &mut ws).expect("records");
        tower.backward(&mut rec, &v_features, &mut ws, &mut v_pixels).expect("records");
        rec.submit().expect("runs");
        (ws.features.read().expect("read"), v_pixels.read().expect("read"))
    });
    // Each of some twenty products rounds its factors by 2^-12 on average; errors of both signs add up to 5 of these.
    for (got, want) in [(&rounded, &features), (&v_rounded, &v_pixels)] {
        let error = relative_distance(got, want);
        assert!(error > 1e-6 && error < 1e-2, "{error} of the length: rounded, and no more");
    }
    let v_tiny: Vec<f32> = v_tiny.iter().map(|v| v / tiny).collect();
    // Powers of two change no rounding, but that of numbers below 2^-24 of their tile's largest.
    let error = relative_distance(&v_tiny, &v_rounded);
    assert!(error < 1e-5, "{error} of the length");
}

#[test]
fn pixel_gradients_match_transformers() {
    let Some(gpu) = device() else { return };
    let tower = mini(&gpu).vision(TowerPurpose::InputGradient).expect("tower");
    // Of the real pictures the first four have gradients.
    for (file, count, all) in [(Some(golden()), 2, 2), (fixtures(), 4, 24)] {
        let Some(file) = file else { continue };
        let planes = &file.floats("pixel_values", &[all, 3, 64, 64]).expect("pictures")[..count * PICTURE];
        let pixels = gpu.buffer_from("pixels", &pixels_of(planes, 64)).expect("buffer");
        let v_features = file.floats("v_image_embeds", &[count, 512]).expect("a gradient");
        let v_features = gpu.buffer_from("v_features", v_features).expect("buffer");
        let mut v_pixels = gpu.buffer_from("v_pixels", &vec![f32::NAN; count * 64 * 64 * 4]).expect("buffer");
        let mut ws = tower.workspace(count).expect("workspace");
        let mut rec = gpu.recorder().expect("recorder");
        tower.forward(&mut rec, &pixels, &mut ws).expect("records");
        tower.backward(&mut rec, &v_features, &mut ws, &mut v_pixels).expect("records");
        rec.submit().expect("runs");
        let want = pixels_of(file.floats("v_pixel_values", &[count, 3, 64, 64]).expect("a gradient"), 64);
        let got = v_pixels.read().expect("read");
        for (g, w) in got.chunks_exact(64 * 64 * 4).zip(want.chunks_exact(64 * 64 * 4)) {
            let similar = cosine(g, w);
            assert!(similar > 0.9999, "cosine {similar}");
            let most = largest(w.iter().map(|v| v.abs()));
            // f32 rounding through eight half-layers and back, relative to the largest entry.
            assert_close(g, w, 1e-3 * most, 1e-3);
        }
    }
}

#[test]
fn activations_computed_again_give_the_same_bits_in_less_memory() {
    let Some(gpu) = own_device() else { return };
    let file = golden();
    let pixels = pixels_of(file.floats("pixel_values", &[2, 3, 64, 64]).expect("pictures"), 64);
    let pixels = gpu.buffer_from("pixels", &pixels).expect("buffer");
    let v_features = file.floats("v_image_embeds", &[2, 512]).expect("a gradient");
    let v_features = gpu.buffer_from("v_features", v_features).expect("buffer");
    let mut v_pixels = gpu.buffer_from("v_pixels", &vec![f32::NAN; 2 * 64 * 64 * 4]).expect("buffer");
    let run = |tower: &VisionTower, ws: &mut VisionWorkspace, v_pixels: &mut Buffer<f32>| {
        let mut rec = gpu.recorder().expect("recorder");
        tower.forward(&mut rec, &pixels, ws).expect("records");
        rec.submit().expect("runs");
        // The second time no forward pass comes first: what is shared is then another layer's.
        [0; 2].map(|_| {
            let mut rec = gpu.recorder().expect("recorder");
            rec.fill(v_pixels, f32::NAN);
            tower.backward(&mut rec, &v_features, ws, v_pixels).expect("records");
            rec.submit().expect("runs");
            v_pixels.read().expect("read").into_iter().map(f32::to_bits).collect::<Vec<_>>()
        })
    };
    let [mut kept, mut lean] = [TowerPurpose::InputGradient, TowerPurpose::LeanInputGradient].map(|purpose| {
        let tower = mini(&gpu).vision(purpose).expect("tower");
        let before = gpu.memory_use().live_bytes;
        let ws = tower.workspace(2).expect("workspace");
        (tower, ws, gpu.memory_use().live_bytes - before)
    });
    // Of three layers, two forget 130 rows of 9 times 128 floats.
    let spared = 2 * 130 * 9 * 128 * size_of::<f32>() as u64;
    assert!(kept.2 >= lean.2 + spared, "{} and {} bytes", kept.2, lean.2);
    let want = run(&kept.0, &mut kept.1, &mut v_pixels);
    assert!(want[0] == want[1], "a backward pass changes nothing that it reads");
    assert!(want[0].iter().any(|v| *v != 0), "a gradient");
    assert!(run(&lean.0, &mut lean.1, &mut v_pixels) == want, "computed again");
    assert!(lean.1.recomputes() && !kept.1.recomputes(), "as the towers were loaded");
    assert!(!lean.1.forget_activations(), "there are none");
    let before = gpu.memory_use().live_bytes;
    assert!(kept.1.forget_activations(), "there were some");
    assert!(gpu.memory_use().live_bytes + spared <= before, "they are gone");
    assert!(run(&kept.0, &mut kept.1, &mut v_pixels) == want, "computed again where they were kept once");
}

#[test]
fn text_features_match_transformers_without_the_padding() {
    let (Some(gpu), Some(file)) = (device(), fixtures()) else { return };
    let tower = mini(&gpu).text().expect("tower");
    let ids = token_ids(&file, "message_ids");
    let tokens = 48 + 2;
    let end = tower.config().begin_and_end().1;
    let sequences: Vec<u32> = ids.chunks_exact(77).flat_map(|row| row[..tokens].to_vec()).collect();
    assert!(sequences.chunks_exact(tokens).all(|s| s[tokens - 1] == end), "48 message tokens between begin and end");
    let got = tower.embed(&sequences, tokens).expect("embeds");
    let want = file.floats("message_embeds", &[4, 512]).expect("fixture");
    assert_features_close(&got.features, &unit_rows(want, 512), 512);
    let alone = tower.embed(&sequences[tokens..2 * tokens], tokens).expect("embeds");
    assert_eq!(alone.features, got.features[512..1024], "a sequence does not depend on its neighbours");
}

#[test]
fn texts_of_several_lengths_match_transformers() {
    let Some(gpu) = device() else { return };
    let tower = mini(&gpu).text().expect("tower");
    let end = tower.config().begin_and_end().1;
    for (file, count) in [(Some(golden()), 2), (fixtures(), 10)] {
        let Some(file) = file else { continue };
        let want = unit_rows(file.floats("text_embeds", &[count, 512]).expect("features"), 512);
        let texts = padded_texts(&file, "input_ids", end);
        for (text, want) in texts.iter().zip(want.chunks_exact(512)) {
            assert_features_close(&tower.embed(text, text.len()).expect("embeds").features, want, 512);
        }
        assert_eq!(texts.len(), count, "texts");
    }
}

#[test]
fn wrong_inputs_are_refused() {
    let Some(gpu) = device() else { return };
    let clip = mini(&gpu);
    let text = clip.text().expect("tower");
    assert!(text.embed(&[1, 2, 3], 2).is_err(), "not a multiple");
    assert!(text.embed(&[49_408], 1).is_err(), "id outside the vocabulary");
    assert!(text.embed(&[0; 78], 78).is_err(), "too long");
    let tower = clip.vision(TowerPurpose::Features).expect("tower");
    let mut ws = tower.workspace(1).expect("workspace");
    let small = gpu.buffer::<f32>("pixels", 16).expect("buffer");
    let mut v_pixels = gpu.buffer::<f32>("v_pixels", 64 * 64 * 4).expect("buffer");
    let v_features = gpu.buffer::<f32>("v_features", 512).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    assert!(tower.forward(&mut rec, &small, &mut ws).is_err(), "wrong size");
    let refused = tower.backward(&mut rec, &v_features, &mut ws, &mut v_pixels);
    assert!(refused.is_err(), "loaded without gradients");
}
