//! splat/rasterize: linear in the colours, adjoint, GPU against the twin, the same bytes twice.

use guard4d_kernels::reference::splat::rasterize as twin;
use guard4d_kernels::reference::splat::tile_bin::pruned_lists as twin_tiles;
use guard4d_kernels::splat::project::View;
use guard4d_kernels::splat::rasterize::{BackwardScratch, Frame, FrameMut, backward, forward, forward_in_bytes};
use guard4d_kernels::splat::rules::{Framebuffer, Rules};
use guard4d_kernels::splat::tile_bin::{Prune, VisibleLists};
use guard4d_kernels::{Device, KernelError};

use super::scene::{self, Scene, screen};
use super::tile_bin::lists;
use crate::support::close::{assert_close, cosine, worst_ratio};
use crate::support::gpu::{Gpu, device, each_family};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const BACKGROUND: [f32; 3] = [1.0, 0.5, 0.25];

/// Rows of `all` `[N,4]` for the visible splats.
fn visible(lists: &VisibleLists, all: &[f32]) -> Vec<f32> {
    let splats = lists.splat_from_visible.read().expect("read");
    splats.iter().take(lists.num_visible).flat_map(|&s| all[4 * s as usize..][..4].to_vec()).collect()
}

/// The opposite: rows of the visible splats at their place among `n`.
fn scatter(lists: &VisibleLists, rows: &[f32], n: usize) -> Vec<f32> {
    let mut all = vec![0.0; 4 * n];
    for (row, &s) in rows.chunks(4).zip(&lists.splat_from_visible.read().expect("read")) {
        all[4 * s as usize..][..4].copy_from_slice(row);
    }
    all
}

fn render(device: &Device, lists: &VisibleLists, colours: &[f32], background: [f32; 3]) -> Vec<f32> {
    render_into(Framebuffer::Floats, device, lists, colours, background)
}

fn render_into(
    framebuffer: Framebuffer,
    device: &Device,
    lists: &VisibleLists,
    colours: &[f32],
    background: [f32; 3],
) -> Vec<f32> {
    let colours = device.buffer_from("colours", colours).expect("buffer");
    let mut image = device.buffer("image", 4 * lists.grid.num_pixels()).expect("buffer");
    let mut rec = device.recorder().expect("recorder");
    let frame = FrameMut { clip: &mut image, index: 0 };
    match framebuffer {
        Framebuffer::Floats => forward(&mut rec, lists, &colours, background, frame),
        Framebuffer::Bytes => forward_in_bytes(&mut rec, lists, &colours, background, frame),
    }
    .expect("records");
    rec.submit().expect("runs");
    image.read().expect("read")
}

fn pull(device: &Device, lists: &VisibleLists, v_image: &[f32]) -> Vec<f32> {
    let v_image = device.buffer_from("v_image", v_image).expect("buffer");
    let mut v_colours = device.buffer("v_colours", 4 * lists.num_visible).expect("buffer");
    let mut scratch = BackwardScratch::new(device, lists.num_isects).expect("scratch");
    let mut rec = device.recorder().expect("recorder");
    let frame = Frame { clip: &v_image, index: 0 };
    backward(&mut rec, lists, frame, &mut scratch, &mut v_colours).expect("records");
    rec.submit().expect("runs");
    v_colours.read().expect("read")
}

#[test]
fn twin_gradient_agrees_with_differences() {
    let (scene, view) = (scene::random(30, 2), scene::view(20, 12));
    let splats = scene.project::<f64>(&view);
    let mut random = Random(3);
    let colours = random.vec(4 * scene.len(), 0.0, 1.0);
    let v_image = random.vec(4 * 20 * 12, -1.0, 1.0);
    let loss = |c: &[f64]| {
        let image = twin::forward(&splats, c, [0.0; 3], &screen(&view));
        image.chunks(4).zip(v_image.chunks(4)).map(|(i, v)| i[0] * v[0] + i[1] * v[1] + i[2] * v[2]).sum::<f64>()
    };
    let grad = twin::backward(&splats, &v_image, &screen(&view));
    assert!(grad.iter().any(|g| g.abs() > 0.1), "the scene is seen");
    // Linear: only rounding remains of the difference.
    assert!(gradcheck(loss, &colours, &grad) < 1e-8);
}

#[test]
fn twin_gradient_agrees_with_differences_by_other_rules() {
    for rules in scene::rules() {
        let (scene, view) = (scene::random(30, 2), View { rules, ..scene::view(60, 40) });
        let splats = scene.project::<f64>(&view);
        let colours = Random(3).vec(4 * scene.len(), 0.0, 1.0);
        let v_image = Random(4).vec(4 * 60 * 40, -1.0, 1.0);
        let loss = |c: &[f64]| {
            let image = twin::forward(&splats, c, [0.0; 3], &screen(&view));
            image.chunks(4).zip(v_image.chunks(4)).map(|(i, v)| i[0] * v[0] + i[1] * v[1] + i[2] * v[2]).sum::<f64>()
        };
        let grad = twin::backward(&splats, &v_image, &screen(&view));
        assert!(grad.iter().any(|g| g.abs() > 0.1), "the scene is seen");
        // Linear: only rounding remains of the difference.
        assert!(gradcheck(loss, &colours, &grad) < 1e-8);
    }
}

/// Along the z axis, 100 px for a unit at a distance of one, and nothing dilated.
fn straight_view() -> View {
    View {
        world_to_camera: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        focal: [100.0; 2],
        centre: [32.0; 2],
        width: 64,
        height: 64,
        rules: Rules { dilation: 0.0, ..Rules::REFERENCE },
    }
}

#[test]
fn twin_pixels_are_what_the_rules_say() {
    // Of a splat of opacity 1/2 and standard deviation 5 px in the middle of pixel 31.5: alpha 5 px from the middle.
    let means = [0.0, 0.0, 2.0, 0.0].to_vec();
    let log = 0.1f32.ln();
    let scene = Scene { means, scales: vec![log, log, log, 0.0], quats: vec![1.0, 0.0, 0.0, 0.0] };
    let view = straight_view();
    let alpha = |rules: Rules, x: usize| {
        let view = View { rules, ..view };
        let image = twin::forward(&scene.project::<f64>(&view), &[1.0; 4], [0.0; 3], &screen(&view));
        image[4 * (32 * 64 + x)]
    };
    let near = |got: f64, want: f64| assert!((got - want).abs() < 1e-6, "{got}, expected {want}");
    let falloff = (-0.5f64).exp();
    near(alpha(view.rules, 37), 0.5 * falloff);
    near(alpha(Rules { foot: 0.25, ..view.rules }, 37), 0.5 * (falloff - 0.25) / 0.75);
    near(alpha(Rules { max_alpha: 0.3, ..view.rules }, 37), 0.3);
    near(alpha(Rules { reach: 0.99, ..view.rules }, 37), 0.0);
    near(alpha(Rules { reach: 1.01, ..view.rules }, 37), 0.5 * falloff);
    near(alpha(Rules { min_alpha: 0.31, ..view.rules }, 37), 0.0);
}

#[test]
fn twin_bytes_are_rounded_after_every_splat() {
    // Three splats of standard deviations of 10 px over one another; the first is in front.
    let means = [0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.1, 0.0, 0.0, 0.0, 2.2, 0.0].to_vec();
    let log = 0.2f32.ln();
    let scene = Scene { means, scales: [log, log, log, 0.0].repeat(3), quats: [1.0, 0.0, 0.0, 0.0].repeat(3) };
    let view = straight_view();
    let splats = scene.project::<f64>(&view);
    let alphas: Vec<f64> = splats.iter().map(|splat| splat.as_ref().expect("seen").opacity).collect();
    let colours = [0.2, 0.5, 9.0, 0.0, 0.9, 0.5, -0.4, 0.0, 0.3, 0.5, 0.6, 0.0];
    let background = [0.1, 0.5, 0.9];
    let image = twin::forward_in_bytes(&splats, &colours, background, &screen(&view));
    // The pixel at the centres, where falloff is what half a pixel leaves of it.
    let falloff = |splat: usize| {
        let [a, b, c] = splats[splat].as_ref().expect("seen").conic;
        let [dx, dy] = splats[splat].as_ref().expect("seen").mean2d.map(|x| x - 32.0);
        (-0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy).exp()
    };
    let in_steps = |x: f64| (255.0 * x.clamp(0.0, 1.0) + 0.5).floor() / 255.0;
    for channel in 0..3 {
        let mut want = in_steps(background[channel]);
        for splat in [2, 1, 0] {
            let alpha = alphas[splat] * falloff(splat);
            want = in_steps(want * (1.0 - alpha) + (alpha * colours[4 * splat + channel]).min(1.0));
        }
        let got = image[4 * (32 * 64 + 32) + channel];
        assert!((got - want).abs() < 1e-12, "channel {channel}: {got}, expected {want}");
    }
    assert_eq!(image[0], in_steps(background[0]), "where there is no splat");
}

#[test]
fn gpu_bytes_follow_the_twin() {
    let Some(gpu) = device() else { return };
    let [_, quads, ..] = scene::rules();
    for rules in [Rules::REFERENCE, quads] {
        for (n, width, height) in [(400, 37, 53), (900, 72, 48)] {
            let (scene, view) = (scene::random(n, n as u64), View { rules, ..scene::view(width, height) });
            let colours = Random(9).vec_f32(4 * scene.len(), -0.2, 2.0);
            let want = twin::forward_in_bytes(&scene.project::<f32>(&view), &colours, BACKGROUND, &screen(&view));
            let lists = lists(&gpu, &scene, &view, Prune::Keep);
            let image = render_into(Framebuffer::Bytes, &gpu, &lists, &visible(&lists, &colours), BACKGROUND);
            let steps = |value: &f32| 255.0 * value;
            assert!(
                image.chunks(4).all(|pixel| pixel[..3].iter().all(|c| (steps(c) - steps(c).round()).abs() < 1e-3)),
                "all colours are steps"
            );
            let off = image.iter().zip(&want).filter(|(g, w)| worst_ratio(&[**g], &[**w], 1e-4, 0.0) > 1.0).count();
            // A half may be rounded to either side, in one of a hundred pixels with some dozen splats each.
            assert!(off * 50 <= image.len(), "{off} of {} values are off", image.len());
            // Two steps: what is a step off is covered by what comes before it.
            assert_close(&image, &want, 2.5 / 255.0, 0.0);
        }
    }
}

#[test]
fn gpu_image_and_gradient_follow_the_twin() {
    let Some(gpu) = device() else { return };
    // The last one has more splats than 16 bits can tell apart.
    for (n, width, height) in [(1, 8, 8), (400, 37, 53), (3000, 200, 120), (2000, 65, 7), (70_000, 96, 64)] {
        let (scene, view) = (scene::random(n, n as u64), scene::view(width, height));
        follow_the_twin(&gpu, &scene, &view);
    }
}

#[test]
fn gpu_image_and_gradient_follow_the_twin_by_other_rules() {
    let Some(gpu) = device() else { return };
    for rules in scene::rules() {
        for (n, width, height) in [(400, 37, 53), (1500, 70, 45)] {
            follow_the_twin(&gpu, &scene::random(n, n as u64), &View { rules, ..scene::view(width, height) });
        }
    }
}

fn follow_the_twin(gpu: &Device, scene: &Scene, view: &View) {
    let splats = scene.project::<f32>(view);
    let mut random = Random(9);
    let colours = random.vec_f32(4 * scene.len(), 0.0, 1.0);
    let v_image = random.vec_f32(4 * (view.width * view.height) as usize, -1.0, 1.0);
    let want_image = twin::forward(&splats, &colours, BACKGROUND, &screen(view));
    let want_grad = twin::backward(&splats, &v_image, &screen(view));
    for prune in [Prune::Keep, Prune::Remove] {
        let lists = lists(gpu, scene, view, prune);
        let image = render(gpu, &lists, &visible(&lists, &colours), BACKGROUND);
        let off = image.iter().zip(&want_image).filter(|(g, w)| worst_ratio(&[**g], &[**w], 1e-4, 0.0) > 1.0).count();
        // Threshold decisions may flip by rounding in a few pixels; each changes at most 1/255 or so.
        assert!(off * 1000 <= image.len(), "{off} of {} values are off by 1e-4", image.len());
        assert_close(&image, &want_image, 0.02, 0.0);
        let grad = scatter(&lists, &pull(gpu, &lists, &v_image), scene.len());
        let angle = cosine(&grad, &want_grad);
        // One flip in a thousand pixels turns the gradient by less than 1e-4.
        assert!(angle > 0.9999 || want_grad.iter().all(|g| *g == 0.0), "cosine {angle}");
    }
}

#[test]
fn both_families_agree() {
    let Some(devices) = each_family() else { return };
    agree(&devices, &scene::view(203, 121));
    for rules in scene::rules() {
        agree(&devices, &View { rules, ..scene::view(120, 83) });
    }
}

fn agree(devices: &[Gpu; 2], view: &View) {
    let scene = scene::random(5000, 13);
    let mut random = Random(14);
    let colours = random.vec_f32(4 * scene.len(), 0.0, 1.0);
    let v_image = random.vec_f32(4 * (view.width * view.height) as usize, -1.0, 1.0);
    let [lanes, tiles] = devices.each_ref().map(|gpu| {
        let lists = lists(gpu, &scene, view, Prune::Remove);
        let image = render(gpu, &lists, &visible(&lists, &colours), BACKGROUND);
        (image, scatter(&lists, &pull(gpu, &lists, &v_image), scene.len()))
    });
    let off = tiles.0.iter().zip(&lanes.0).filter(|(t, l)| worst_ratio(&[**t], &[**l], 1e-4, 0.0) > 1.0).count();
    // As against the twin: a decision may flip by rounding where a device fuses products with sums in one of them.
    assert!(off * 1000 <= lanes.0.len(), "{off} of {} values are off by 1e-4", lanes.0.len());
    assert_close(&tiles.0, &lanes.0, 0.02, 0.0);
    let angle = cosine(&tiles.1, &lanes.1);
    assert!(angle > 0.9999, "cosine {angle}");
}

#[test]
fn pruning_changes_no_bit_and_twice_gives_the_same_bytes() {
    let Some(gpu) = device() else { return };
    let [wide, quads, bent, split] = scene::rules();
    for rules in [Rules::REFERENCE, wide, quads, bent, split] {
        let (scene, view) = (scene::random(4000, 8), View { rules, ..scene::view(150, 90) });
        let mut random = Random(1);
        let colours = random.vec_f32(4 * scene.len(), 0.0, 1.0);
        let v_image = random.vec_f32(4 * 150 * 90, -1.0, 1.0);
        let run = |prune| {
            let lists = lists(&gpu, &scene, &view, prune);
            let image = render(&gpu, &lists, &visible(&lists, &colours), BACKGROUND);
            let grad = scatter(&lists, &pull(&gpu, &lists, &v_image), scene.len());
            (image, grad, lists.num_isects)
        };
        let (image, grad, pairs) = run(Prune::Remove);
        let (image_again, grad_again, _) = run(Prune::Remove);
        assert!(image == image_again && grad == grad_again, "the same bytes twice");
        let (image_full, grad_full, pairs_full) = run(Prune::Keep);
        assert!(pairs < pairs_full, "{pairs} of {pairs_full} pairs stay");
        assert!(image == image_full, "the image is the same to the bit");
        // Zero terms in other places only change where a sum is rounded.
        assert_close(&grad, &grad_full, 1e-4, 1e-5);
    }
}

#[test]
fn rules_that_say_the_same_in_other_words_draw_the_same() {
    let Some(gpu) = device() else { return };
    let (scene, view) = (scene::random(3000, 15), scene::view(150, 90));
    let colours = Random(16).vec_f32(4 * scene.len(), 0.0, 1.0);
    let draw = |rules| {
        let lists = lists(&gpu, &scene, &View { rules, ..view }, Prune::Keep);
        render(&gpu, &lists, &visible(&lists, &colours), BACKGROUND)
    };
    let plain = draw(Rules::REFERENCE);
    let general = draw(Rules { guard: 1e6, reach: 1e6, ..Rules::REFERENCE });
    let off = general.iter().zip(&plain).filter(|(g, p)| worst_ratio(&[**g], &[**p], 1e-4, 0.0) > 1.0).count();
    // As against the twin: a decision may flip by rounding.
    assert!(off * 1000 <= plain.len(), "{off} of {} values are off by 1e-4", plain.len());
    assert_close(&general, &plain, 0.02, 0.0);
}

#[test]
fn image_is_linear_in_colours_and_background_and_backward_is_the_adjoint() {
    let Some(gpu) = device() else { return };
    let (scene, view) = (scene::random(1500, 6), scene::view(96, 64));
    let lists = lists(&gpu, &scene, &view, Prune::Remove);
    let mut random = Random(2);
    let a = random.vec_f32(4 * lists.num_visible, -1.0, 1.0);
    let b = random.vec_f32(4 * lists.num_visible, -1.0, 1.0);
    let sum: Vec<f32> = a.iter().zip(&b).map(|(x, y)| x + 2.0 * y).collect();
    let black = [0.0; 3];
    let (image_a, image_b) = (render(&gpu, &lists, &a, black), render(&gpu, &lists, &b, black));
    let image = render(&gpu, &lists, &sum, BACKGROUND);
    let mut want = vec![0.0; image.len()];
    for (i, w) in want.iter_mut().enumerate() {
        let t = image_a[i / 4 * 4 + 3];
        *w = if i % 4 == 3 { t } else { image_a[i] + 2.0 * image_b[i] + t * BACKGROUND[i % 4] };
    }
    // A hundred products of size one per pixel at most, each rounded to 6e-8.
    assert_close(&image, &want, 2e-5, 0.0);
    // <A b, g> = <b, A^T g>, accumulated in f64.
    let g = random.vec_f32(image.len(), -1.0, 1.0);
    let dot = |x: &[f32], y: &[f32]| {
        let rgb = |i: &usize| i % 4 != 3;
        (0..x.len()).filter(rgb).map(|i| f64::from(x[i]) * f64::from(y[i])).sum::<f64>()
    };
    let (left, right) = (dot(&image_b, &g), dot(&b, &pull(&gpu, &lists, &g)));
    let norm = dot(&image_b, &image_b).sqrt() * dot(&g, &g).sqrt();
    assert!((left - right).abs() <= 1e-6 * norm, "{left} against {right}, norm {norm}");
}

#[test]
fn frames_of_a_clip_are_written_and_read_at_their_place() {
    let Some(gpu) = device() else { return };
    let (scene, view) = (scene::random(300, 7), scene::view(37, 53));
    let lists = lists(&gpu, &scene, &view, Prune::Remove);
    let colours = vec![0.5; 4 * lists.num_visible];
    let alone = render(&gpu, &lists, &colours, BACKGROUND);
    let pixels = 4 * lists.grid.num_pixels();
    let buffer = gpu.buffer_from("colours", &colours).expect("buffer");
    let mut clip = gpu.buffer_from("clip", &vec![7.0f32; 3 * pixels]).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let frame = FrameMut { clip: &mut clip, index: 1 };
    forward(&mut rec, &lists, &buffer, BACKGROUND, frame).expect("records");
    rec.submit().expect("runs");
    let all = clip.read().expect("read");
    assert!(all[pixels..2 * pixels] == alone[..], "the frame");
    assert!(all[..pixels].iter().chain(&all[2 * pixels..]).all(|v| *v == 7.0), "its neighbours");
    let mut v_clip = vec![f32::NAN; 3 * pixels];
    v_clip[pixels..2 * pixels].copy_from_slice(&alone);
    let v_buffer = gpu.buffer_from("v_clip", &v_clip).expect("buffer");
    let mut v_colours = gpu.buffer("v_colours", 4 * lists.num_visible).expect("buffer");
    let mut scratch = BackwardScratch::new(&gpu, lists.num_isects).expect("scratch");
    let mut rec = gpu.recorder().expect("recorder");
    let frame = Frame { clip: &v_buffer, index: 1 };
    backward(&mut rec, &lists, frame, &mut scratch, &mut v_colours).expect("records");
    rec.submit().expect("runs");
    assert!(v_colours.read().expect("read") == pull(&gpu, &lists, &alone), "reads its own frame only");
    let mut rec = gpu.recorder().expect("recorder");
    let error = forward(&mut rec, &lists, &buffer, BACKGROUND, FrameMut { clip: &mut clip, index: 3 });
    assert!(matches!(error, Err(KernelError::Shape { buffer: "clip", .. })), "{error:?}");
}

#[test]
fn an_empty_scene_shows_the_background_and_has_no_gradient() {
    let Some(gpu) = device() else { return };
    let empty = Scene { means: vec![], scales: vec![], quats: vec![] };
    let lists = lists(&gpu, &empty, &scene::view(37, 53), Prune::Remove);
    let image = render(&gpu, &lists, &[], BACKGROUND);
    let [r, g, b] = BACKGROUND;
    assert!(image.chunks(4).all(|p| p == [r, g, b, 1.0]), "background everywhere");
    assert!(pull(&gpu, &lists, &vec![1.0; image.len()]).is_empty(), "no splat, no gradient");
}

#[test]
fn poison_fills_the_tiles_it_meets() {
    let Some(gpu) = device() else { return };
    let (width, height) = (37, 26);
    let (scene, view) = (scene::random(60, 12), scene::view(width, height));
    let lists = lists(&gpu, &scene, &view, Prune::Remove);
    let splats = scene.project::<f32>(&view);
    let split = 4 * scene.len();
    let num_px = lists.grid.num_pixels();
    let clean = Random(5).vec_f32(split + 4 * num_px, 0.1, 1.0);
    let on_gpu = |data: &[f32]| {
        let image = render(&gpu, &lists, &visible(&lists, &data[..split]), BACKGROUND);
        [image, scatter(&lists, &pull(&gpu, &lists, &data[split..]), scene.len())].concat()
    };
    let on_host = |data: &[f32]| {
        let image = twin::forward(&splats, &data[..split], BACKGROUND, &screen(&view));
        [image, twin::backward(&splats, &data[split..], &screen(&view))].concat()
    };
    // Of the first visible splat, which lanes beyond the end of a list load too, and of one in the middle, a colour
    // and the fourth channel; of a pixel in the middle of the image the same.
    let seen = lists.splat_from_visible.read().expect("read");
    let [first, middle] = [0, lists.num_visible / 2].map(|i| 4 * seen[i] as usize);
    let pixel = split + 4 * (13 * width as usize + 18);
    let places = [first, middle + 1, middle + 3, pixel + 2, pixel + 3];
    // Sums of some dozen products below 1 in the image; of some hundred in the gradient.
    let reach = poison::spread(&clean, &places, (1e-4, 1e-5), on_gpu, on_host);
    let want = twin_tiles(&splats, &screen(&view));
    let tile_px = |tile: usize| {
        let (x, y) = (8 * (tile % 5), 8 * (tile / 5));
        (width as usize - x).min(8) * (height as usize - y).min(8)
    };
    let filled = |splat: usize| (0..want.len()).filter(|&t| want[t].contains(&(splat / 4))).map(tile_px).sum::<usize>();
    assert!(filled(first) > 0 && filled(middle) < num_px, "some tiles list a splat, others do not");
    assert_eq!(reach, [filled(first), filled(middle), 0, want[5 + 2].len(), 0], "all pixels, all splats of a tile");
}

#[test]
fn long_lists_run_to_their_end() {
    let Some(gpu) = device() else { return };
    // One tile, faint splats: every one counts, none stops the pixel.
    let n = 20_000;
    let mut scene = scene::random(n, 11);
    for (i, mean) in scene.means.chunks_mut(4).enumerate() {
        mean.copy_from_slice(&[0.0, 0.0, i as f32 * 1e-4, -5.4]);
    }
    scene.scales.fill(-1.0);
    let view = scene::view(8, 8);
    let lists = lists(&gpu, &scene, &view, Prune::Keep);
    assert_eq!(lists.num_isects, n, "all in the one tile");
    let splats = scene.project::<f32>(&view);
    let colours = Random(4).vec_f32(4 * n, 0.0, 1.0);
    let image = render(&gpu, &lists, &visible(&lists, &colours), BACKGROUND);
    let want = twin::forward(&splats, &colours, BACKGROUND, &screen(&view));
    // 2000 blended splats of weight 0.004 and less, each rounded to 6e-8; one may flip at the stop.
    assert_close(&image, &want, 1e-3, 0.0);
}
