//! splat/project: the twin against a camera worked out by hand, GPU against the twin.

use guard4d_engine::base::numbers::narrow;
use guard4d_kernels::reference::splat::traverse::traverse;
use guard4d_kernels::splat::project::{Projection, View, forward};
use guard4d_kernels::splat::rules::{Extent, Opacity, Rules, SortKey};

use super::scene::{self, Scene, screen};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};

const LOG2_E: f32 = std::f32::consts::LOG2_E;

struct Read {
    geom: Vec<f32>,
    dirs: Vec<f32>,
    rects: Vec<u32>,
    keys: Vec<u32>,
}

fn run(gpu: &Gpu, scene: &Scene, view: &View) -> Read {
    let n = scene.len();
    let uploaded = scene.upload(gpu);
    let mut out = Projection::new(gpu, n).expect("projection");
    let mut rec = gpu.recorder().expect("recorder");
    forward(&mut rec, view, uploaded.raw(), n, &mut out).expect("records");
    rec.submit().expect("runs");
    Read {
        geom: out.geom.read().expect("read"),
        dirs: out.dirs.read().expect("read"),
        rects: out.tile_rects.read().expect("read"),
        keys: out.order.keys.read().expect("read"),
    }
}

fn axis_aligned(means: &[[f32; 4]], scale: f32) -> Scene {
    Scene {
        means: means.concat(),
        scales: [scale.ln(), scale.ln(), scale.ln(), 0.0].repeat(means.len()),
        quats: [1.0, 0.0, 0.0, 0.0].repeat(means.len()),
    }
}

fn straight_view() -> View {
    View {
        world_to_camera: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        focal: [100.0, 100.0],
        centre: [31.5, 31.5],
        width: 64,
        height: 64,
        rules: Rules::REFERENCE,
    }
}

#[test]
fn twin_projects_a_sphere_on_the_axis() {
    let scene = axis_aligned(&[[0.0, 0.0, 2.0, 0.0]], 0.1);
    let splat = scene.project::<f64>(&straight_view())[0].expect("seen");
    // f s / z = 100 * 0.1 / 2 = 5 px, so the variance is 25 + 0.3; the axis meets pixel (S - 1) / 2.
    assert!((splat.mean2d[0] - 31.5).abs() < 1e-6 && (splat.mean2d[1] - 31.5).abs() < 1e-6, "{splat:?}");
    assert!((splat.conic[0] - 1.0 / 25.3).abs() < 1e-6 && splat.conic[1].abs() < 1e-9, "{splat:?}");
    assert!((splat.opacity - 0.5).abs() < 1e-9 && splat.depth == 2.0 && splat.dir[2] == 1.0, "{splat:?}");
    // Radius ceil(3 sqrt(25.3 + sqrt 0.1)) = 16: from 15.5 to 47.5 px.
    assert_eq!(splat.tiles, [0, 0, 3, 3]);
}

#[test]
fn twin_shapes_a_sphere_as_the_rules_say() {
    let scene = axis_aligned(&[[0.0, 0.0, 2.0, 0.0]], 0.02);
    let project = |rules| scene.project::<f64>(&View { rules, ..straight_view() })[0];
    // 1 px of standard deviation: dilated by 1 px² the area is twice as large, so the root of the ratio is 1/2.
    let wide = Rules { dilation: 1.0, opacity: Opacity::Compensated, ..Rules::REFERENCE };
    let splat = project(wide).expect("seen");
    assert!((splat.opacity - 0.25).abs() < 1e-6 && (splat.conic[0] - 0.5).abs() < 1e-6, "{splat:?}");
    // Variances of 1.3 px², half a px² apart on either side; the longer axis lies along x where none is longer.
    let splat = project(Rules { min_split: 0.5, ..Rules::REFERENCE }).expect("seen");
    let [x, y] = [1.0 / 0.8, 1.0 / 1.8];
    assert!((splat.conic[0] - x).abs() < 1e-6 && (splat.conic[2] - y).abs() < 1e-6, "{splat:?}");
    assert!(project(Rules { min_split: 1.4, ..Rules::REFERENCE }).is_none(), "no ellipse has a negative variance");
    let splat = project(Rules { min_minor: 2.0, ..Rules::REFERENCE }).expect("seen");
    assert!((splat.conic[0] - 1.0 / 1.3).abs() < 1e-6 && (splat.conic[2] - 0.5).abs() < 1e-6, "{splat:?}");
    assert!(project(Rules { min_major: 1.31, ..Rules::REFERENCE }).is_none(), "too small to be drawn");
    assert_eq!(project(Rules { extent: Extent::Image, ..Rules::REFERENCE }).expect("seen").tiles, [0, 0, 4, 4]);
}

#[test]
fn near_plane_opacity_and_image_cull() {
    let means = [
        [0.0, 0.0, 0.2, 0.0],    // on the near plane
        [0.0, 0.0, 0.2001, 0.0], // just beyond
        [0.0, 0.0, 2.0, -6.0],   // opacity below 1/255
        [9.0, 0.0, 2.0, 0.0],    // beside the image
        [0.0, 0.0, -2.0, 0.0],   // behind
    ];
    let scene = axis_aligned(&means, 0.01);
    let seen: Vec<_> = scene.project::<f32>(&straight_view()).iter().map(Option::is_some).collect();
    assert_eq!(seen, [false, true, false, false, false]);
    let Some(gpu) = device() else { return };
    let read = run(&gpu, &scene, &straight_view());
    for (i, seen) in seen.into_iter().enumerate() {
        assert_eq!(read.keys[i] != u32::MAX, seen, "splat {i}");
        assert_eq!(read.rects[4 * i + 2] > read.rects[4 * i], seen, "splat {i}");
    }
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (n, width, height) in [(1, 40, 40), (700, 37, 53), (2000, 200, 160)] {
        follows_the_twin(&gpu, &scene::random(n, n as u64), &scene::view(width, height));
    }
}

#[test]
fn gpu_follows_the_twin_by_other_rules() {
    let Some(gpu) = device() else { return };
    let scene = scene::random(1500, 21);
    for rules in scene::rules() {
        let view = View { rules, ..scene::view(150, 110) };
        assert!(follows_the_twin(&gpu, &scene, &view) > 100, "splats are seen by {rules:?}");
    }
}

/// How many splats both see.
fn follows_the_twin(gpu: &Gpu, scene: &Scene, view: &View) -> usize {
    let read = run(gpu, scene, view);
    // In double precision: determinants of thin ellipses cancel.
    let twin = scene.project::<f64>(view);
    let mut seen = 0;
    for (i, splat) in twin.iter().enumerate() {
        let Some(s) = splat else {
            assert_eq!(read.keys[i], u32::MAX, "splat {i} is culled");
            continue;
        };
        if read.keys[i] == u32::MAX {
            // The device culls by 8 x 8 tiles and by the alpha threshold as well.
            let mut hits = 0;
            traverse(&[*splat], &screen(view), |_| hits += 1);
            assert_eq!(hits, 0, "splat {i} is culled but reaches a pixel");
            continue;
        }
        seen += 1;
        let geom = &read.geom[8 * i..8 * i + 8];
        // A few dozen roundings at coordinates of a few hundred px.
        assert_close(&geom[..2], &s.mean2d.map(narrow), 1e-3, 0.0);
        let half = -0.5 * LOG2_E;
        let [a, b, c] = s.conic.map(narrow);
        let conic = [a * half, 2.0 * b * half, c * half];
        let size = conic[0].abs() + conic[2].abs();
        // Relative to the largest entry; the determinant of elongated splats cancels.
        assert_close(&[geom[2], geom[3], geom[4]], &conic, 2e-4 * size, 0.0);
        // The driver's exp is within 1e-6 relative, depth has four roundings, compensation a root of a few dozen.
        assert_close(&geom[5..7], &[s.opacity, s.depth].map(narrow), 0.0, 2e-5);
        assert_close(&read.dirs[4 * i..4 * i + 3], &s.dir.map(narrow), 1e-6, 0.0);
        assert_close(&[f32::from_bits(read.keys[i])], &[narrow(s.key)], 0.0, 1e-5);
        let by_depth = view.rules.sort_key == SortKey::Depth;
        assert_eq!(read.keys[i] == geom[6].to_bits(), by_depth, "splat {i}: whether the key is the depth");
        let rect = &read.rects[4 * i..4 * i + 4];
        // The fine rectangle lies inside the coarse one; one tile of slack where a ceil may flip.
        assert!((0..2).all(|k| rect[k] as usize + 2 >= 2 * s.tiles[k]), "{rect:?} in {:?}", s.tiles);
        assert!((2..4).all(|k| rect[k] as usize <= 2 * s.tiles[k] + 2), "{rect:?} in {:?}", s.tiles);
    }
    seen
}

#[test]
fn poison_and_huge_splats_never_reach_the_lists_as_numbers_that_are_not() {
    let Some(gpu) = device() else { return };
    let mut scene = scene::random(64, 1);
    let poison = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40, 1e30, -1e30];
    for (i, value) in poison.into_iter().enumerate() {
        scene.means[4 * i] = value;
        scene.means[4 * (i + 8) + 3] = value;
        scene.scales[4 * (i + 16)] = value;
        scene.quats[4 * (i + 24) + 1] = value;
    }
    scene.quats[4 * 40..4 * 41].fill(0.0);
    scene.scales[4 * 41..4 * 42].fill(18.0);
    scene.scales[4 * 42] = 18.0;
    scene.scales[4 * 43..4 * 44].fill(-23.0);
    let read = run(&gpu, &scene, &scene::view(64, 48));
    assert!(read.geom.iter().chain(&read.dirs).all(|v| v.is_finite()), "only finite records");
    assert!(read.rects.chunks(4).all(|r| r[2] <= 8 && r[3] <= 6), "rectangles inside the image");
    for i in [0, 1, 2, 8, 16, 17, 24] {
        assert_eq!(read.keys[i], u32::MAX, "splat {i} is dropped");
    }
    for i in [40, 41, 42, 43] {
        assert_ne!(read.keys[i], u32::MAX, "splat {i} is drawn: zero quaternion, huge, needle, point");
    }
}

#[test]
fn quaternions_keep_their_length_where_the_scales_say_so() {
    let Some(gpu) = device() else { return };
    // Twice a unit along w has the matrix of the unit; a component beside it has not.
    let mut scene = axis_aligned(&[[0.0, 0.0, 2.0, 0.0], [0.3, 0.1, 2.5, 0.0]], 0.1);
    scene.scales[0] = 0.3f32.ln();
    scene.scales[4] = 0.3f32.ln();
    scene.quats = [1.6, 0.2, 0.4, 0.3].repeat(2);
    let unit = run(&gpu, &scene, &straight_view());
    scene.scales[3] = 1.0;
    scene.scales[7] = 1.0;
    let kept = run(&gpu, &scene, &straight_view());
    let want = scene.project::<f64>(&straight_view());
    for (row, splat) in want.iter().enumerate() {
        let splat = splat.as_ref().expect("seen");
        let conic = [kept.geom[8 * row + 2], kept.geom[8 * row + 3], kept.geom[8 * row + 4]];
        // Stored times -log2(e)/2, the second twice that.
        let got = [conic[0] / -0.5 / LOG2_E, conic[1] / -LOG2_E, conic[2] / -0.5 / LOG2_E].map(f64::from);
        let close = got.iter().zip(splat.conic).all(|(g, w)| (g - w).abs() < 1e-5 * splat.conic[0].abs());
        assert!(close, "splat {row}: {got:?} against {:?}", splat.conic);
    }
    assert!(kept.geom.iter().zip(&unit.geom).any(|(a, b)| (a - b).abs() > 1e-3), "another ellipse than the unit's");
}
