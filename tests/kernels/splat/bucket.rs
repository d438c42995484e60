//! splat/bucket: buckets of depth against the twin's, and lists by them.

use guard4d_kernels::Device;
use guard4d_kernels::reference::splat::bucket as twin;
use guard4d_kernels::splat::bucket;
use guard4d_kernels::splat::project::{self, Buckets, Projection, RawSplats, View};
use guard4d_kernels::splat::rules::{Rules, SortKey};
use guard4d_kernels::splat::tile_bin::{Prune, TileBinner};

use super::scene::{self, Scene};
use crate::support::close::largest;
use crate::support::gpu::device;
use crate::support::random::Random;

const CORNERS: [[f32; 3]; 2] = [[-1.2, -1.1, -1.3], [1.1, 1.2, 1.4]];

/// Any order of the splats, the same each time.
fn along(n: usize) -> Vec<u32> {
    let mut random = Random(12);
    let mut rows: Vec<u32> = (0..n as u32).collect();
    (1..n).rev().for_each(|at| rows.swap(at, random.below(at + 1)));
    rows
}

fn buckets(gpu: &Device, n: usize) -> Buckets {
    Buckets { along: gpu.buffer_from("along", &along(n)).expect("a buffer"), corners: CORNERS }
}

/// Depth of the box's corners, nearest and farthest.
fn reach(view: &View) -> [f64; 2] {
    let [x, y, z, shift] = view.world_to_camera[2].map(f64::from);
    let depth = |corner: usize| {
        let [a, b, c] = [0, 1, 2].map(|axis| f64::from(CORNERS[corner >> axis & 1][axis]));
        a * x + b * y + c * z + shift
    };
    [-largest((0..8).map(|corner| -depth(corner))), largest((0..8).map(depth))]
}

fn sorted_by_buckets(view: View) -> View {
    View { rules: Rules { sort_key: SortKey::Buckets, ..view.rules }, ..view }
}

#[test]
fn keys_are_the_twins() {
    let Some(gpu) = device() else { return };
    for (n, width) in [(1, 8), (500, 37), (20_000, 200)] {
        let (scene, view) = (scene::random(n, 7), sorted_by_buckets(scene::view(width, width)));
        let uploaded = scene.upload(&gpu);
        let mut projection = Projection::new(&gpu, n).expect("fits");
        let mut rec = gpu.recorder().expect("a recorder");
        project::forward(&mut rec, &view, uploaded.raw(), n, &mut projection).expect("projects");
        bucket::forward(&mut rec, &view, &buckets(&gpu, n), n, &mut projection).expect("as many splats");
        rec.submit().expect("runs");
        let (geom, keys) = (projection.geom.read().expect("read"), projection.order.keys.read().expect("read"));
        let along = along(n);
        assert_eq!(projection.order.values.read().expect("read")[..n], along);
        let depth_of = |splat: u32| f64::from(geom[8 * splat as usize + 6]);
        let count = bucket::count(n);
        let depths: Vec<f64> = along.iter().map(|splat| depth_of(*splat)).collect();
        let want = twin::keys(&depths, reach(&view), count);
        let mut other = 0;
        for ((key, want), depth) in keys.iter().zip(want).zip(&depths) {
            if *depth == 0.0 {
                assert_eq!(*key, count + 1, "what is not drawn comes last");
            } else {
                // 32-bit numbers may be on the other side of a border.
                assert!(key.abs_diff(want) <= 1, "{key} for {want} at {depth}");
                other += u32::from(*key != want);
            }
        }
        assert!(other as usize * 50 <= n, "{other} of {n} are in the next bucket");
        assert!(n < 500 || depths.iter().filter(|depth| **depth > 0.0).count() > n / 2, "most are drawn");
    }
}

#[test]
fn buckets_are_as_many_as_a_quarter_of_the_splats() {
    let counts = [1, 4_721, 152_746, 100_000_000].map(bucket::count);
    assert_eq!(counts, [1025, 1025, 32_769, 1_048_577]);
    assert_eq!([1, 4_721, 100_000_000].map(bucket::key_bits), [11, 11, 21]);
}

fn order_of(gpu: &Device, scene: &Scene, view: &View, buckets: Option<&Buckets>) -> Vec<u32> {
    let uploaded = scene.upload(gpu);
    let splats = RawSplats { buckets, ..uploaded.raw() };
    let mut binner = TileBinner::new(gpu).expect("a binner");
    let (lists, _) = binner.build(view, splats, scene.len(), Prune::Keep).expect("builds");
    let rows = lists.splat_from_visible.read().expect("read");
    lists.pairs().expect("read").into_iter().map(|[splat, _]| rows[splat as usize]).collect()
}

#[test]
fn splats_of_one_bucket_stand_in_the_order_that_is_given() {
    let Some(gpu) = device() else { return };
    // One tile, and splats so close to each other that they share the last bucket: another order than by depth.
    let mut scene = scene::random(40, 3);
    for (row, mean) in scene.means.chunks_exact_mut(4).enumerate() {
        mean.copy_from_slice(&[-0.1, 0.1, 1.39 - 1e-5 * row as f32, 3.0]);
    }
    scene.scales.fill(-2.0);
    let view = scene::view(8, 8);
    let by_depth = order_of(&gpu, &scene, &view, None);
    assert_eq!(by_depth, (0..40).rev().collect::<Vec<u32>>(), "the nearest is the last");
    let by_buckets = order_of(&gpu, &scene, &sorted_by_buckets(view), Some(&buckets(&gpu, 40)));
    assert_eq!(by_buckets, along(40));
    // Without them such rules say nothing.
    let refused = TileBinner::new(&gpu).expect("a binner").build(
        &sorted_by_buckets(view),
        scene.upload(&gpu).raw(),
        40,
        Prune::Keep,
    );
    let refused = refused.expect_err("no buckets").to_string();
    assert!(refused.contains("buckets"), "{refused}");
    let short = buckets(&gpu, 39);
    let uploaded = scene.upload(&gpu);
    let short = RawSplats { buckets: Some(&short), ..uploaded.raw() };
    let mut binner = TileBinner::new(&gpu).expect("a binner");
    assert!(binner.build(&sorted_by_buckets(view), short, 40, Prune::Keep).is_err(), "one of them is missing");
}
