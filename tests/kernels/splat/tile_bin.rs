//! splat/tile_bin: lists against the twin's, which are found pixel by pixel.

use guard4d_kernels::Device;
use guard4d_kernels::reference::splat::tile_bin as twin;
use guard4d_kernels::splat::project::View;
use guard4d_kernels::splat::tile_bin::{Prune, TileBinner, VisibleLists};

use super::scene::{self, Scene, screen};
use crate::support::gpu::device;

pub(crate) fn lists(device: &Device, scene: &Scene, view: &View, prune: Prune) -> VisibleLists {
    let mut binner = TileBinner::new(device).expect("binner");
    binner.build(view, scene.upload(device).raw(), scene.len(), prune).expect("builds").0
}

/// Splats of each tile, front to back.
fn by_tile(lists: &VisibleLists) -> Vec<Vec<usize>> {
    let splats = lists.splat_from_visible.read().expect("read");
    let pairs = lists.pairs().expect("read");
    let offsets = lists.tile_offsets.read().expect("read");
    let scene_row = |pair: &[u32; 2]| splats[pair[0] as usize] as usize;
    let ids = |w: &[u32]| pairs[w[0] as usize..w[1] as usize].iter().map(scene_row).collect();
    offsets.windows(2).map(ids).collect()
}

#[test]
fn lists_hold_what_each_tile_sees_in_depth_order() {
    let Some(gpu) = device() else { return };
    for (n, width, height) in [(1, 8, 8), (500, 37, 53), (3000, 200, 120)] {
        let (scene, view) = (scene::random(n, n as u64), scene::view(width, height));
        let projected = scene.project::<f32>(&view);
        let want = twin::pruned_lists(&projected, &screen(&view));
        let kept = by_tile(&lists(&gpu, &scene, &view, Prune::Keep));
        let pruned = by_tile(&lists(&gpu, &scene, &view, Prune::Remove));
        let rank: Vec<_> = projected.iter().map(|s| s.map_or(f32::INFINITY, |s| s.depth)).collect();
        let (mut total, mut differing) = (0, 0);
        for tile in 0..want.len() {
            // Depths agree to 1e-5 between device and twin, so only closer pairs may swap.
            let ordered = |list: &[usize]| list.windows(2).all(|w| rank[w[0]] <= rank[w[1]] + 1e-4);
            assert!(ordered(&kept[tile]) && ordered(&pruned[tile]), "tile {tile} is in depth order");
            assert!(pruned[tile].iter().all(|s| kept[tile].contains(s)), "tile {tile}: pruning only removes");
            total += want[tile].len();
            differing += want[tile].iter().filter(|s| !pruned[tile].contains(s)).count();
            differing += pruned[tile].iter().filter(|s| !want[tile].contains(s)).count();
        }
        // Decisions at the alpha and stop thresholds may flip by rounding: less than 1 in 500 does.
        assert!(differing * 500 <= total, "{differing} of {total} pairs differ");
    }
}

#[test]
fn poisoned_splats_are_dropped_or_drawn_and_change_no_other() {
    let Some(gpu) = device() else { return };
    let view = scene::view(90, 70);
    let clean = scene::random(200, 5);
    let mut poisoned = scene::random(200, 5);
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40];
    for (i, value) in bad.into_iter().enumerate() {
        poisoned.means[4 * i] = value;
        poisoned.means[4 * (i + 4) + 3] = value;
        poisoned.scales[4 * (i + 8) + 1] = value;
        poisoned.quats[4 * (i + 12) + 2] = value;
    }
    let kept = by_tile(&lists(&gpu, &poisoned, &view, Prune::Keep));
    let others = |list: &[usize]| list.iter().copied().filter(|s| *s >= 16).collect::<Vec<_>>();
    for (tile, list) in by_tile(&lists(&gpu, &clean, &view, Prune::Keep)).iter().enumerate() {
        assert_eq!(others(&kept[tile]), others(list), "tile {tile}: the other splats, in the same order");
    }
    // What the twin's projection drops is not drawn: positions, opacities and shapes that are no numbers.
    let projected = poisoned.project::<f32>(&view);
    for (splat, by_twin) in projected.iter().enumerate() {
        let drawn = kept.iter().any(|list| list.contains(&splat));
        assert!(!drawn || by_twin.is_some(), "splat {splat} is dropped");
    }
    let pruned = lists(&gpu, &poisoned, &view, Prune::Remove);
    let geom = pruned.geom.read().expect("read");
    assert!(geom.iter().all(|v| v.is_finite()), "only finite records are drawn");
    let (want, got) = (twin::pruned_lists(&projected, &screen(&view)), by_tile(&pruned));
    let pairs = |lists: &[Vec<usize>]| lists.iter().map(Vec::len).sum::<usize>();
    let differing: usize = want.iter().zip(&got).map(|(w, g)| w.iter().filter(|s| !g.contains(s)).count()).sum();
    // As above: decisions at the thresholds may flip.
    assert!(differing * 500 <= pairs(&want), "{differing} of {} pairs are missing", pairs(&want));
    assert!(pairs(&got) * 500 <= pairs(&want) * 501, "{} pairs, expected {}", pairs(&got), pairs(&want));
}

#[test]
fn slots_of_a_splat_are_contiguous_and_each_is_used_once() {
    let Some(gpu) = device() else { return };
    slots_are_sound(&lists(&gpu, &scene::random(800, 4), &scene::view(90, 70), Prune::Remove), true);
    // More splats than 16 bits can tell apart.
    slots_are_sound(&lists(&gpu, &scene::random(70_000, 4), &scene::view(90, 70), Prune::Keep), false);
}

fn slots_are_sound(lists: &VisibleLists, is_packed: bool) {
    assert_eq!(lists.is_packed(), is_packed, "{} splats", lists.num_visible);
    let ranges = lists.slot_ranges.read().expect("read");
    let mut used = vec![false; lists.num_isects];
    for (i, [splat, at]) in lists.pairs().expect("read").into_iter().enumerate() {
        let s = splat as usize;
        assert!(ranges[2 * s] <= at && at < ranges[2 * s + 1], "pair {i} lies in its splat's range");
        assert!(!std::mem::replace(&mut used[at as usize], true), "slot {at} is used twice");
    }
    assert!(used.iter().all(|u| *u), "every slot is used");
    let splats = lists.splat_from_visible.read().expect("read");
    assert!(splats.windows(2).all(|w| w[0] < w[1]), "visible splats stand in the order of the scene");
    let (order, offsets) = (lists.tile_order.read().expect("read"), lists.tile_offsets.read().expect("read"));
    let has_pairs = |tile: u32| offsets[tile as usize + 1] > offsets[tile as usize];
    assert!(order[lists.num_active..].iter().all(|&t| !has_pairs(t)), "tiles beyond the active ones are empty");
    let mut tiles = order.clone();
    tiles.sort_unstable();
    assert!(tiles.into_iter().eq(0..lists.grid.num_tiles()), "every tile once");
}

#[test]
fn nothing_to_see_gives_empty_lists() {
    let Some(gpu) = device() else { return };
    let empty = Scene { means: vec![], scales: vec![], quats: vec![] };
    let mut behind = scene::random(20, 1);
    behind.means.chunks_mut(4).for_each(|m| m[2] = -50.0);
    for scene in [empty, behind] {
        for prune in [Prune::Keep, Prune::Remove] {
            let lists = lists(&gpu, &scene, &scene::view(37, 53), prune);
            assert_eq!((lists.num_visible, lists.num_isects), (0, 0));
            assert!(lists.tile_offsets.read().expect("read").iter().all(|&o| o == 0), "all tiles are empty");
        }
    }
}

#[test]
fn images_without_pixels_or_with_too_many_tiles_are_refused() {
    let Some(gpu) = device() else { return };
    let scene = scene::random(3, 1);
    let uploaded = scene.upload(&gpu);
    let mut binner = TileBinner::new(&gpu).expect("binner");
    for (width, height) in [(0, 8), (8, 0), (1 << 20, 1 << 20)] {
        let view = View { width, height, ..scene::view(8, 8) };
        assert!(binner.build(&view, uploaded.raw(), 3, Prune::Keep).is_err(), "{width} x {height}");
    }
    let view = scene::view(64, 64);
    assert!(binner.build(&view, uploaded.raw(), 4, Prune::Keep).is_err(), "more splats than the buffers hold");
    assert!(binner.build(&view, uploaded.raw(), 3, Prune::Keep).is_ok(), "and the binner still works");
}
