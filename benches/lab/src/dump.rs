//! Single operations driven from files, for comparison with other implementations.
//!
//! Every function takes and gives tensors by name; nothing here is used by embedding or verification.

use std::path::Path;

use guard4d_engine::base::files::{bad_data, read_file};
use guard4d_engine::base::numbers::narrow;
use guard4d_engine::base::tensor_file::{Tensor, TensorFile, Values};
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::{ClipModel, TowerPurpose};
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::render::{Offsets, Renderer};
use guard4d_engine::scene::{Camera, CameraSet, FrameSize, Model};
use guard4d_kernels::image::resize::{self, ImageSize, Onward, ResizePlan};
use guard4d_kernels::loss::Term;
use guard4d_kernels::loss::ssim::{self, SsimPair, SsimReference, SsimScratch};
use guard4d_kernels::nn::conv3d::{
    self, Activation, Bias, Conv3d, Conv3dScratch, InputGradient, Padding, WeightGradient,
};
use guard4d_kernels::nn::pack::Precision;
use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState};
use guard4d_kernels::shape::{Accumulate, ClipShape, OffsetBases};
use guard4d_kernels::splat::rasterize::{Frame, FrameMut};
use guard4d_kernels::splat::tile_bin::Prune;
use guard4d_kernels::{Buffer, Device};

/// Floats of a pixel on the device.
const TEXEL: usize = 4;
/// Colour channels of a file's images.
const RGB: usize = 3;
/// Images that go through CLIP at once.
const IMAGES: usize = 8;

/// Borders of [`conv3d()`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Border {
    /// Zeros on all sides.
    Zero,
    /// Nearest frame in time, mirrored in space: what the extractor uses.
    Clip,
}

/// One view with its picture's background.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Camera.
    pub camera: Camera,
    /// Time in \[0, 1\].
    pub time: f32,
    /// Background, when the file names one; otherwise the model's is taken.
    pub background: Option<[f32; 3]>,
}

impl View {
    /// Reads a file with one camera; `time` replaces the file's, and without either it is 0.
    ///
    /// # Errors
    /// Those of [`CameraSet::parse`]; [`EngineError::BadData`] for several cameras or a background that is no colour.
    pub fn open(path: &Path, time: Option<f32>) -> Result<Self, EngineError> {
        let json = read_file(path, "a camera file")?;
        let set = CameraSet::parse(path, &json, FrameSize::DNERF)?;
        let [view] = &set.views[..] else {
            return Err(bad_data(path, "cameras", set.views.len(), "one"));
        };
        let value: serde_json::Value = serde_json::from_slice(&json).expect("it was parsed a moment ago");
        let background = value.get("background").map(|colour| {
            let parts: Option<Vec<f32>> =
                colour.as_array().and_then(|c| c.iter().map(|v| v.as_f64().map(narrow)).collect());
            let parts = parts.and_then(|p| <[f32; 3]>::try_from(p).ok());
            parts.ok_or_else(|| bad_data(path, "background", colour, "three numbers"))
        });
        let time = time.or(view.times.first().copied()).unwrap_or(0.0);
        Ok(Self { camera: view.camera, time, background: background.transpose()? })
    }
}

/// Splats of `model` at `time`, before activation.
///
/// # Shapes
/// out `feat` \[N,levels·channels\] · `hidden` \[N,width\] (both only of moving models) · `xyz` \[N,3\] ·
/// `scale` \[N,3\] · `rot` \[N,4\] · `opacity` \[N,1\] · `sh` \[N,16,3\]
///
/// # Errors
/// [`EngineError::Usage`] for a time outside \[0, 1\]; when the device fails.
pub fn deform(device: &Device, model: &Model, time: f32) -> Result<TensorFile, EngineError> {
    check_time(time)?;
    let mut field = DeformField::new(device, &model.gaussians, &model.motion)?;
    let n = field.len();
    let mut out = TensorFile::default();
    if let Some(rows) = field.hidden(time)? {
        let columns = |values: &[f32]| values.len() / n.max(1);
        put(&mut out, "feat", &[n, columns(&rows.feat)], rows.feat);
        put(&mut out, "hidden", &[n, columns(&rows.hidden)], rows.hidden);
    }
    let state = field.at(time)?;
    let raw = state.raw();
    let (means, scales) = (raw.means.read()?, raw.scales.read()?);
    put(&mut out, "xyz", &[n, 3], columns(&means, TEXEL, 0..3));
    put(&mut out, "opacity", &[n, 1], columns(&means, TEXEL, 3..4));
    put(&mut out, "scale", &[n, 3], columns(&scales, TEXEL, 0..3));
    put(&mut out, "rot", &[n, 4], raw.quats.read()?);
    put(&mut out, "sh", &[n, 16, 3], state.sh_coeffs().read()?);
    Ok(out)
}

/// One view of `model`, and with `v_image` the gradient of its SH coefficients.
///
/// # Shapes
/// in `dL_dimage` \[H,W,3\] · out `image` \[H,W,3\] not clamped · `final_T` \[H,W\] · `dL_dsh` \[N,16,3\]
///
/// # Errors
/// [`EngineError::Usage`] for a time outside \[0, 1\]; [`EngineError::BadData`] for another shape; when the device
/// fails.
pub fn render(
    device: &Device,
    model: &Model,
    view: &View,
    v_image: Option<&TensorFile>,
) -> Result<TensorFile, EngineError> {
    check_time(view.time)?;
    let (height, width) = (view.camera.height as usize, view.camera.width as usize);
    let v_image = v_image.map(|file| file.floats("dL_dimage", &[height, width, RGB])).transpose()?;
    let mut field = DeformField::new(device, &model.gaussians, &model.motion)?;
    let state = field.at(view.time)?;
    let mut renderer = Renderer::new(device)?;
    let plan = renderer.plan(&state, &view.camera, Prune::Keep)?;
    let mut frame = device.buffer("dump.frame", plan.frame_len())?;
    let mut rec = device.recorder()?;
    let background = view.background.unwrap_or(model.background);
    renderer.forward(&mut rec, &plan, None, background, FrameMut { clip: &mut frame, index: 0 })?;
    rec.submit()?;
    let pixels = frame.read()?;
    let mut out = TensorFile::default();
    put(&mut out, "image", &[height, width, RGB], columns(&pixels, TEXEL, 0..RGB));
    put(&mut out, "final_T", &[height, width], columns(&pixels, TEXEL, RGB..TEXEL));
    if let Some(v_image) = v_image {
        let v_frame = device.buffer_from("dump.v_frame", &widen(v_image, RGB, TEXEL))?;
        let coefficients = state.sh_coeffs().len();
        let offsets = device.buffer("dump.offsets", coefficients)?;
        let mut v_offsets = device.buffer("dump.v_offsets", coefficients)?;
        let mut rec = device.recorder()?;
        let offsets = Offsets { data: &offsets, bases: OffsetBases::All };
        renderer.backward(&mut rec, &plan, offsets, Frame { clip: &v_frame, index: 0 }, &mut v_offsets)?;
        rec.submit()?;
        put(&mut out, "dL_dsh", &[state.len(), 16, 3], v_offsets.read()?);
    }
    Ok(out)
}

/// Features of images and texts, and the gradient of the pixels.
///
/// # Shapes
/// in, each optional: `pixel_values` \[B,3,S,S\] normalised · `v_image_embeds` \[G,D\], gradient of the features of the
/// first G ≤ B images · `input_ids` \[T,77\] ·
/// out `image_embeds` \[B,D\] and `text_embeds` \[T,D\] of unit length · `v_pixel_values` \[G,3,S,S\]
///
/// # Errors
/// [`EngineError::BadData`] naming the tensor that does not fit; when the device fails.
pub fn clip(device: &Device, clip: &ClipModel, input: &TensorFile) -> Result<TensorFile, EngineError> {
    let mut out = TensorFile::default();
    if input.tensors.contains_key("pixel_values") {
        images(device, clip, input, &mut out)?;
    } else if input.tensors.contains_key("v_image_embeds") {
        input.get("pixel_values")?;
    }
    if let Some(ids) = input.tensors.get("input_ids") {
        texts(clip, input, ids, &mut out)?;
    }
    if out.tensors.is_empty() {
        return Err(bad_data(&input.path, "tensors", "neither of them", "pixel_values or input_ids"));
    }
    Ok(out)
}

fn images(device: &Device, clip: &ClipModel, input: &TensorFile, out: &mut TensorFile) -> Result<(), EngineError> {
    let (side, dim) = (clip.config().vision_config.image_size, clip.config().projection_dim);
    let (shape, planes) = floats::<4>(input, "pixel_values", "f32 [B,3,S,S]")?;
    if shape[1..] != [RGB, side, side] {
        return Err(bad_data(&input.path, "pixel_values", format!("{shape:?}"), format!("[B,3,{side},{side}]")));
    }
    let v_features = match input.tensors.contains_key("v_image_embeds") {
        true => floats::<2>(input, "v_image_embeds", "f32 [G,D]").map(Some)?,
        false => None,
    };
    if let Some((got, _)) = v_features.filter(|(got, _)| got[0] > shape[0] || got[1] != dim) {
        let expected = format!("[G,{dim}] with G up to {}", shape[0]);
        return Err(bad_data(&input.path, "v_image_embeds", format!("{got:?}"), expected));
    }
    let wanted = v_features.map_or(0, |(got, _)| got[0]);
    let purpose = if v_features.is_some() { TowerPurpose::InputGradient } else { TowerPurpose::Features };
    let tower = clip.vision(purpose)?;
    let mut ws = tower.workspace(IMAGES)?;
    let per_image = RGB * side * side;
    let mut pixels = device.buffer("dump.pixels", IMAGES * side * side * TEXEL)?;
    let mut v_in = device.buffer("dump.v_features", IMAGES * dim)?;
    let mut v_pixels = device.buffer("dump.v_pixels", pixels.len())?;
    let (mut features, mut v_planes) = (Vec::new(), Vec::new());
    for (number, chunk) in planes.chunks(IMAGES * per_image).enumerate() {
        let (first, count) = (number * IMAGES, chunk.len() / per_image);
        pixels.write_at(0, &to_texels(chunk, side))?;
        let here = wanted.saturating_sub(first).min(count);
        let mut rec = device.recorder()?;
        tower.forward(&mut rec, &pixels, &mut ws)?;
        if let Some((_, v)) = v_features.filter(|_| here > 0) {
            v_in.write_at(0, &v[first * dim..(first + here) * dim])?;
            tower.backward(&mut rec, &v_in, &mut ws, &mut v_pixels)?;
        }
        rec.submit()?;
        features.extend(ws.features.read_range(0..count * dim)?);
        v_planes.extend(to_planes(&v_pixels.read_range(0..here * side * side * TEXEL)?, side));
    }
    put(out, "image_embeds", &[shape[0], dim], features);
    if v_features.is_some() {
        put(out, "v_pixel_values", &[wanted, RGB, side, side], v_planes);
    }
    Ok(())
}

fn texts(clip: &ClipModel, input: &TensorFile, ids: &Tensor, out: &mut TensorFile) -> Result<(), EngineError> {
    let bad = |got: String, expected: &str| bad_data(&input.path, "input_ids", got, expected);
    let [rows, length] = ids.shape[..] else {
        return Err(bad(format!("{:?}", ids.shape), "[T,77]"));
    };
    let number = |id: i64| u32::try_from(id).map_err(|_| bad(id.to_string(), "token ids"));
    let values: Vec<u32> = match &ids.values {
        Values::U32(values) => values.clone(),
        Values::I64(values) => values.iter().map(|&id| number(id)).collect::<Result<_, _>>()?,
        Values::F32(_) => return Err(bad("floats".to_owned(), "integers")),
    };
    let tower = clip.text()?;
    let end = tower.config().begin_and_end().1;
    let mut features = Vec::new();
    for row in values.chunks(length.max(1)) {
        let last = row.iter().position(|id| *id == end);
        let tokens = 1 + last.ok_or_else(|| bad("a row without it".to_owned(), &format!("the end token {end}")))?;
        features.extend(tower.embed(&row[..tokens], tokens)?.features);
    }
    put(out, "text_embeds", &[rows, tower.projection_dim()], features);
    Ok(())
}

/// A 3×3×3 convolution, and with `v_y` its gradients.
///
/// # Shapes
/// in `x` \[F,H,W,Ci\] · `weight` \[Co,Ci,3,3,3\] · optional `bias` \[Co\], `v_y` \[F,H,W,Co\] ·
/// out `y` \[F,H,W,Co\] · `v_x` · `v_weight` · `v_bias` (with a bias)
///
/// # Errors
/// [`EngineError::BadData`] naming the tensor that does not fit; when the device fails.
pub fn conv3d(device: &Device, input: &TensorFile, border: Border) -> Result<TensorFile, EngineError> {
    let ([frames, height, width, ci], x) = floats::<4>(input, "x", "f32 [F,H,W,Ci]")?;
    let (weight_shape, weight) = floats::<5>(input, "weight", "f32 [Co,Ci,3,3,3]")?;
    let co = weight_shape[0];
    input.floats("weight", &[co, ci, 3, 3, 3])?;
    let bias = optional(input, "bias", &[co])?;
    let v_y = optional(input, "v_y", &[frames, height, width, co])?;
    let (time, space) = match border {
        Border::Zero => (Padding::Zero, Padding::Zero),
        Border::Clip => (Padding::Replicate, Padding::Reflect),
    };
    let conv = Conv3d {
        shape: ClipShape { frames, height, width },
        in_channels: ci.next_multiple_of(TEXEL),
        out_channels: co.next_multiple_of(TEXEL),
        time,
        space,
        bias: if bias.is_some() { Bias::Added } else { Bias::None },
        activation: Activation::Identity,
        precision: Precision::F32,
    };
    let mut packed = conv.pack(weight, ci, co);
    let terms = packed.len() - if bias.is_some() { conv.out_channels } else { 0 };
    packed[terms..][..bias.map_or(0, <[f32]>::len)].copy_from_slice(bias.unwrap_or_default());
    let x = device.buffer_from("dump.x", &widen(x, ci, conv.in_channels))?;
    let weight = device.buffer_from("dump.weight", &packed)?;
    let mut y = device.buffer("dump.y", conv.shape.pixels() * conv.out_channels)?;
    let mut rec = device.recorder()?;
    conv3d::forward(&mut rec, &conv, &x, &weight, &mut y)?;
    rec.submit()?;
    let mut out = TensorFile::default();
    put(&mut out, "y", &[frames, height, width, co], columns(&y.read()?, conv.out_channels, 0..co));
    if let Some(v_y) = v_y {
        let v_y = device.buffer_from("dump.v_y", &widen(v_y, co, conv.out_channels))?;
        let [v_x, v_weight] = conv3d_gradients(device, &conv, &x, &weight, &v_y)?;
        put(&mut out, "v_x", &[frames, height, width, ci], columns(&v_x, conv.in_channels, 0..ci));
        put(&mut out, "v_weight", &weight_shape, conv.unpack(&v_weight, ci, co));
        if bias.is_some() {
            put(&mut out, "v_bias", &[co], v_weight[terms..][..co].to_vec());
        }
    }
    Ok(out)
}

/// Gradients to input and packed weights of a layer.
fn conv3d_gradients(
    device: &Device,
    conv: &Conv3d,
    x: &Buffer<f32>,
    weight: &Buffer<f32>,
    v_y: &Buffer<f32>,
) -> Result<[Vec<f32>; 2], EngineError> {
    let mut v_x = device.buffer("dump.v_x", x.len())?;
    let mut v_weight = device.buffer("dump.v_weight", conv.weight_len())?;
    let mut scratch = Conv3dScratch::new(device, conv)?;
    let mut rec = device.recorder()?;
    let from = InputGradient { v_y, weight, gate: None };
    conv3d::backward_input(&mut rec, conv, from, &mut v_x, &mut scratch)?;
    let pass = WeightGradient { x, v_y, v_weight: &mut v_weight, accumulate: Accumulate::Overwrite };
    conv3d::backward_weight(&mut rec, conv, pass, &mut scratch)?;
    rec.submit()?;
    Ok([v_x.read()?, v_weight.read()?])
}

/// Mean SSIM of a clip against a reference, and its gradient.
///
/// # Shapes
/// in `x`, `y` \[F,H,W,C\], C = 3 or 4, the fourth channel unread · out `value` \[1\] · `v_x` like `x`
///
/// # Errors
/// [`EngineError::BadData`] naming the tensor that does not fit; when the device fails.
pub fn ssim(device: &Device, input: &TensorFile) -> Result<TensorFile, EngineError> {
    let (shape, x) = pixels(input)?;
    let y = input.floats("y", &shape)?;
    let [frames, height, width, channels] = shape;
    let size = ImageSize { height, width };
    let mut scratch = SsimScratch::new(device, size, frames)?;
    let mut moments = SsimReference::new(device, size, frames)?;
    let reference = device.buffer_from("dump.reference", &widen(y, channels, TEXEL))?;
    let clip = device.buffer_from("dump.clip", &widen(x, channels, TEXEL))?;
    let mut v_clip = device.buffer("dump.v_clip", clip.len())?;
    let mut values = device.buffer("dump.values", 1)?;
    // The kernel's value is 1 − SSIM.
    let term = Term { values: &mut values, slot: 0, weight: -1.0, accumulate: Accumulate::Overwrite };
    let mut rec = device.recorder()?;
    ssim::prepare(&mut rec, &reference, &mut moments, &mut scratch)?;
    let pair = SsimPair { clip: &clip, reference: &reference, moments: &moments };
    ssim::step(&mut rec, &pair, &mut v_clip, term, &mut scratch)?;
    rec.submit()?;
    let mut out = TensorFile::default();
    put(&mut out, "value", &[1], values.read()?.iter().map(|v| 1.0 - v).collect());
    put(&mut out, "v_x", &shape, columns(&v_clip.read()?, TEXEL, 0..channels));
    Ok(out)
}

/// A clip in another size (bilinear, antialiased, corners aligned), and with `v_y` the gradient to it.
///
/// # Shapes
/// in `x` \[F,H,W,C\], C = 3 or 4, the fourth channel unread · optional `v_y` \[F,h,w,C\] · `to` \[h,w\] ·
/// out `y` \[F,h,w,C\] · `v_x` like `x`; a fourth channel is zero
///
/// # Errors
/// [`EngineError::BadData`] naming the tensor that does not fit; [`EngineError::Usage`] for an empty size; when the
/// device fails.
pub fn resize(device: &Device, input: &TensorFile, to: [usize; 2]) -> Result<TensorFile, EngineError> {
    let (shape, x) = pixels(input)?;
    let [frames, height, width, channels] = shape;
    let [to_height, to_width] = to;
    if to.contains(&0) {
        let (got, expected) = (format!("{to_width}x{to_height}"), "at least 1x1".to_owned());
        return Err(EngineError::Usage { what: "size".to_owned(), got, expected });
    }
    let small = [frames, to_height, to_width, channels];
    let v_y = optional(input, "v_y", &small)?;
    let (from, to) = (ImageSize { height, width }, ImageSize { height: to_height, width: to_width });
    let plan = ResizePlan::new(device, from, to)?;
    let mut scratch = plan.scratch(device, frames)?;
    let x = device.buffer_from("dump.x", &widen(x, channels, TEXEL))?;
    let mut y = device.buffer("dump.y", frames * to_height * to_width * TEXEL)?;
    let mut rec = device.recorder()?;
    resize::forward(&mut rec, &plan, &x, &mut y, &mut scratch)?;
    rec.submit()?;
    let mut out = TensorFile::default();
    put(&mut out, "y", &small, columns(&y.read()?, TEXEL, 0..channels));
    if let Some(v_y) = v_y {
        let v_y = device.buffer_from("dump.v_y", &widen(v_y, channels, TEXEL))?;
        let mut v_x = device.buffer("dump.v_x", x.len())?;
        let mut rec = device.recorder()?;
        resize::backward(&mut rec, &plan, &v_y, &mut v_x, Onward::default(), &mut scratch)?;
        rec.submit()?;
        put(&mut out, "v_x", &shape, columns(&v_x.read()?, TEXEL, 0..channels));
    }
    Ok(out)
}

/// Adam steps on given gradients.
///
/// # Shapes
/// in `param` \[n\] · `grads` \[steps,n\] · `hyper` \[4\]: learning rate, both decays and epsilon ·
/// out `history` \[steps,n\], the parameters after each step · `exp_avg` and `exp_avg_sq` \[n\], the last moments
///
/// # Errors
/// [`EngineError::BadData`] naming the tensor that does not fit; when the device fails.
pub fn adam(device: &Device, input: &TensorFile) -> Result<TensorFile, EngineError> {
    let ([n], param) = floats::<1>(input, "param", "f32 [n]")?;
    let ([steps, _], _) = floats::<2>(input, "grads", "f32 [steps,n]")?;
    let grads = input.floats("grads", &[steps, n])?;
    let hyper = <[f32; 4]>::try_from(input.floats("hyper", &[4])?);
    let [lr, beta1, beta2, eps] = hyper.expect("the shape was checked a moment ago");
    let config = AdamConfig { lr, beta1, beta2, eps, ..AdamConfig::default() };
    let mut param = device.buffer_from("dump.param", param)?;
    let mut state = AdamState::new(device, "dump.param", n)?;
    let mut history = Vec::with_capacity(grads.len());
    for grad in grads.chunks(n.max(1)) {
        let v_param = device.buffer_from("dump.v_param", grad)?;
        let mut rec = device.recorder()?;
        adam::step(&mut rec, &mut param, &v_param, &mut state, &config)?;
        rec.submit()?;
        history.extend(param.read()?);
    }
    let mut out = TensorFile::default();
    put(&mut out, "history", &[steps, n], history);
    put(&mut out, "exp_avg", &[n], state.exp_avg.read()?);
    put(&mut out, "exp_avg_sq", &[n], state.exp_avg_sq.read()?);
    Ok(out)
}

fn check_time(time: f32) -> Result<(), EngineError> {
    if (0.0..=1.0).contains(&time) {
        return Ok(());
    }
    Err(EngineError::Usage { what: "time".to_owned(), got: time.to_string(), expected: "0 to 1".to_owned() })
}

fn put(file: &mut TensorFile, name: &str, shape: &[usize], values: Vec<f32>) {
    file.tensors.insert(name.to_owned(), Tensor::f32(shape, values));
}

/// A float tensor of `D` dimensions and its shape.
fn floats<'a, const D: usize>(
    file: &'a TensorFile,
    name: &str,
    expected: &str,
) -> Result<([usize; D], &'a [f32]), EngineError> {
    let tensor = file.get(name)?;
    let shape = <[usize; D]>::try_from(&tensor.shape[..]);
    let shape = shape.map_err(|_| bad_data(&file.path, name, format!("{:?}", tensor.shape), expected))?;
    Ok((shape, file.floats(name, &shape)?))
}

/// The clip `x`, whose pixels may have a fourth channel.
fn pixels(file: &TensorFile) -> Result<([usize; 4], &[f32]), EngineError> {
    let expected = "f32 [F,H,W,3 or 4], not empty";
    let (shape, values) = floats::<4>(file, "x", expected)?;
    if !(RGB..=TEXEL).contains(&shape[3]) || values.is_empty() {
        return Err(bad_data(&file.path, "x", format!("{shape:?}"), expected));
    }
    Ok((shape, values))
}

/// The floats of a tensor that may be left away.
fn optional<'a>(file: &'a TensorFile, name: &str, shape: &[usize]) -> Result<Option<&'a [f32]>, EngineError> {
    file.tensors.contains_key(name).then(|| file.floats(name, shape)).transpose()
}

/// Some columns of rows of `stride` values.
fn columns(rows: &[f32], stride: usize, keep: std::ops::Range<usize>) -> Vec<f32> {
    rows.chunks(stride.max(1)).flat_map(|row| row[keep.clone()].iter().copied()).collect()
}

/// Rows of `from` values with zeros behind them up to `to`.
fn widen(rows: &[f32], from: usize, to: usize) -> Vec<f32> {
    rows.chunks(from.max(1)).flat_map(|row| row.iter().copied().chain(std::iter::repeat_n(0.0, to - from))).collect()
}

/// `[B,3,S,S]` as `[B,S,S,4]`.
fn to_texels(planes: &[f32], side: usize) -> Vec<f32> {
    let area = side * side;
    let texel = |image: &[f32], i: usize| [image[i], image[area + i], image[2 * area + i], 0.0];
    planes.chunks(RGB * area).flat_map(|image| (0..area).flat_map(move |i| texel(image, i))).collect()
}

/// `[B,S,S,4]` as `[B,3,S,S]`.
fn to_planes(texels: &[f32], side: usize) -> Vec<f32> {
    let images = texels.chunks(TEXEL * side * side);
    images.flat_map(|image| (0..RGB).flat_map(|c| image.iter().skip(c).step_by(TEXEL).copied())).collect()
}
