//! Copies of the built-in scene leak as assets, edited in every way that leaves an asset of use, and are told apart.

use std::path::Path;

use glam::{DQuat, DVec3};
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::asset::{AssetEvidence, gather_asset};
use guard4d_engine::fingerprint::estimate::estimate;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::fingerprint::similarity::Similarity;
use guard4d_engine::fingerprint::trace::{Scored, Scorer};
use guard4d_engine::scene::axes::HalfTurn;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::formats::Export;
use guard4d_engine::scene::gaussians::{SH_FLOATS, Y0};
use guard4d_engine::scene::{Gaussians, Model};
use half::f16;

use crate::support::gpu::{Gpu, device};
use crate::support::random::Random;
use crate::support::shared;

/// Copies that are looked at.
const COPIES: u64 = 1000;
const LEAKED: u64 = 703;
/// The usual amplitudes.
const STRENGTH: f64 = 1.0;

fn prf(seed: u8) -> Prf {
    Prf::new(&MasterSecret::from_bytes([seed; 32]))
}

fn demo() -> Model {
    let scene = DemoScene::unpack().expect("the scene unpacks");
    Model::open(scene.path()).expect("the scene opens")
}

/// The model with other splats.
fn with(model: &Model, gaussians: Gaussians) -> Model {
    let mut other = model.clone();
    other.gaussians = gaussians;
    other
}

fn stamped(model: &Model, issue: &Issue<'_>) -> Gaussians {
    Gaussians { sh_coeffs: issue.stamp(LEAKED), ..model.gaussians.clone() }
}

fn best(gpu: &Gpu, issue: &Issue<'_>, found: &AssetEvidence) -> Vec<Scored> {
    let evidence = estimate(issue, &mut found.clone()).expect("of each splat").chips;
    Scorer::new(gpu, issue, &evidence).and_then(|scorer| scorer.best(0..COPIES)).expect("scores")
}

/// What is wrong unless the best of all names the copy that leaked, and no other.
fn misnamed(what: &str, found: &AssetEvidence, best: &[Scored]) -> Option<String> {
    let [first, others @ ..] = best else { return Some(format!("{what}: nobody")) };
    eprintln!("{what}: {} splats found again, T {:.1}, ln p {:.0}", found.matched, first.score, first.log_p_family);
    let is_named = first.copy == LEAKED && first.log_p_family < 1e-6f64.ln();
    let is_only = others.iter().all(|other| other.log_p_family > 1e-3f64.ln());
    (!is_named || !is_only).then(|| format!("{what}: {:?}", &best[..2]))
}

/// The splats of these rows, as often as they are named.
fn rows(gaussians: &Gaussians, rows: &[usize]) -> Gaussians {
    let sh_coeffs = rows.iter().flat_map(|row| &gaussians.sh_coeffs[SH_FLOATS * row..SH_FLOATS * (row + 1)]);
    Gaussians {
        means: rows.iter().map(|row| gaussians.means[*row]).collect(),
        quats: rows.iter().map(|row| gaussians.quats[*row]).collect(),
        scales: rows.iter().map(|row| gaussians.scales[*row]).collect(),
        opacities: rows.iter().map(|row| gaussians.opacities[*row]).collect(),
        sh_coeffs: sh_coeffs.copied().collect(),
        sh_degree: gaussians.sh_degree,
    }
}

fn reordered(gaussians: &mut Gaussians, random: &mut Random) {
    let mut order: Vec<usize> = (0..gaussians.len()).collect();
    (1..order.len()).rev().for_each(|row| order.swap(row, random.below(row + 1)));
    *gaussians = rows(gaussians, &order);
}

fn pruned(gaussians: &mut Gaussians, random: &mut Random, percent: usize) {
    let keep: Vec<bool> = (0..gaussians.len()).map(|_| random.below(100) >= percent).collect();
    gaussians.retain(&keep);
}

/// Moves everything, as programs do: splats turn and grow too.
fn moved(gaussians: &mut Gaussians, by: &Similarity) {
    for mean in &mut gaussians.means {
        *mean = by.apply(DVec3::from_array(mean.map(f64::from))).as_vec3().to_array();
    }
    for quat in &mut gaussians.quats {
        let [w, x, y, z] = quat.map(f64::from);
        let turned = by.rotation * DQuat::from_xyzw(x, y, z, w);
        *quat = [turned.w, turned.x, turned.y, turned.z].map(|value| value as f32);
    }
    gaussians.scales.iter_mut().flatten().for_each(|scale| *scale += by.scale.ln() as f32);
}

/// Any rotation, and a shift of some of the new size.
fn anywhere(scale: f64, random: &mut Random) -> Similarity {
    let mut number = || random.uniform(-1.0, 1.0);
    let rotation = DQuat::from_xyzw(number(), number(), number(), number()).normalize();
    let translation = 3.0 * scale * DVec3::new(number(), number(), number());
    Similarity { scale, rotation, translation }
}

/// Changes each splat's base colour, 0 to 1 and beyond.
fn recoloured(gaussians: &mut Gaussians, mut to: impl FnMut(usize, f64) -> f64) {
    for row in gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS) {
        for (channel, dc) in row[..3].iter_mut().enumerate() {
            *dc = ((to(channel, 0.5 + Y0 * f64::from(*dc)) - 0.5) / Y0) as f32;
        }
    }
}

fn noisy(gaussians: &mut Gaussians, random: &mut Random) {
    recoloured(gaussians, |_, colour| colour + random.uniform(-0.1, 0.1));
}

fn exposed(gaussians: &mut Gaussians, _: &mut Random) {
    recoloured(gaussians, |channel, colour| [1.2, 0.8, 0.9][channel] * colour + [0.05, -0.02, 0.1][channel]);
}

fn bent(gaussians: &mut Gaussians, _: &mut Random) {
    recoloured(gaussians, |_, colour| colour.max(0.0).powf(1.2));
}

/// One side of the asset alone.
fn cut(gaussians: &mut Gaussians, _: &mut Random) {
    let [middle, ..] = gaussians.median_centre();
    let keep: Vec<bool> = gaussians.means.iter().map(|mean| mean[0] > middle).collect();
    gaussians.retain(&keep);
}

fn without_sh(gaussians: &mut Gaussians, _: &mut Random) {
    gaussians.sh_coeffs.chunks_exact_mut(SH_FLOATS).for_each(|row| row[3..].fill(0.0));
    gaussians.sh_degree = 0;
}

/// Positions as 16-bit floats, colours and opacities in 255 steps.
fn rounded(gaussians: &mut Gaussians, _: &mut Random) {
    gaussians.means.iter_mut().flatten().for_each(|x| *x = f16::from_f32(*x).to_f32());
    gaussians.opacities.iter_mut().for_each(|logit| *logit = (*logit * 16.0).round() / 16.0);
    recoloured(gaussians, |_, colour| (colour * 255.0).round() / 255.0);
}

/// Splats of other sizes, more and less transparent.
fn restyled(gaussians: &mut Gaussians, random: &mut Random) {
    gaussians.scales.iter_mut().flatten().for_each(|scale| *scale = 0.7 * *scale + random.uniform(-1.0, 1.0) as f32);
    gaussians.opacities.iter_mut().for_each(|logit| *logit += random.uniform(-4.0, 4.0) as f32);
}

/// Every third splat twice.
fn doubled(gaussians: &mut Gaussians, _: &mut Random) {
    let all: Vec<usize> = (0..gaussians.len()).chain((0..gaussians.len()).step_by(3)).collect();
    *gaussians = rows(gaussians, &all);
}

/// Half as many splats of somebody else: a floor through the asset, wider than it.
fn with_a_floor(gaussians: &mut Gaussians, random: &mut Random) {
    let own = gaussians.len();
    let all: Vec<usize> = (0..own).chain((0..own / 2).map(|_| random.below(own))).collect();
    *gaussians = rows(gaussians, &all);
    for row in own..gaussians.len() {
        gaussians.means[row] = [random.uniform(-2.0, 2.0) as f32, random.uniform(-2.0, 2.0) as f32, 0.1];
        gaussians.opacities[row] = random.uniform(-1.0, 3.0) as f32;
    }
    let floor = gaussians.sh_coeffs[SH_FLOATS * own..].iter_mut();
    floor.for_each(|coefficient| *coefficient = random.uniform(-1.0, 1.0) as f32);
}

/// Every third splat becomes one with the next: what a decimation makes of them lies between both.
fn merged(gaussians: &mut Gaussians, _: &mut Random) {
    for row in (0..gaussians.len() - 1).step_by(3) {
        let next = gaussians.means[row + 1];
        gaussians.means[row] = std::array::from_fn(|axis| 0.5 * (gaussians.means[row][axis] + next[axis]));
    }
    let keep: Vec<bool> = (0..gaussians.len()).map(|row| row % 3 != 1).collect();
    gaussians.retain(&keep);
}

type Edit = fn(&mut Gaussians, &mut Random);

/// Everything that keeps an asset of use, at once.
const ALL: [Edit; 8] = [
    with_a_floor,
    doubled,
    |g, r| pruned(g, r, 30),
    without_sh,
    exposed,
    noisy,
    |g, r| moved(g, &anywhere(2.0, r)),
    reordered,
];

const EDITS: [(&str, &[Edit]); 24] = [
    ("as it is", &[]),
    ("reordered", &[reordered]),
    ("a tenth pruned", &[|g, r| pruned(g, r, 10)]),
    ("three tenths pruned", &[|g, r| pruned(g, r, 30)]),
    ("half pruned", &[|g, r| pruned(g, r, 50)]),
    ("moved in order", &[|g, r| moved(g, &anywhere(1.0, r))]),
    ("a hundredth of the size", &[reordered, |g, r| moved(g, &anywhere(0.01, r))]),
    ("a hundred times the size", &[reordered, |g, r| moved(g, &anywhere(100.0, r))]),
    ("half pruned and moved", &[|g, r| pruned(g, r, 50), reordered, |g, r| moved(g, &anywhere(3.0, r))]),
    ("in the axes of SPZ", &[reordered, |g, _| HalfTurn::AboutX.apply(g)]),
    ("in the axes of glTF", &[reordered, |g, _| HalfTurn::AboutZ.apply(g)]),
    ("rounded", &[rounded]),
    ("rounded and reordered", &[rounded, reordered]),
    ("colour noise", &[noisy]),
    ("without SH", &[without_sh]),
    ("restyled", &[restyled]),
    ("restyled, recoloured and moved", &[restyled, noisy, reordered, |g, r| moved(g, &anywhere(2.0, r))]),
    ("exposed", &[exposed]),
    ("with a gamma", &[bent]),
    ("doubled", &[doubled]),
    ("on somebody else's floor", &[with_a_floor, reordered]),
    ("merged", &[merged]),
    ("half cut away", &[cut, reordered, |g, r| moved(g, &anywhere(2.0, r))]),
    ("all at once", &ALL),
];

#[test]
fn edited_copies_name_themselves_and_no_other() {
    let Some(gpu) = device() else { return };
    let model = demo();
    let issue = Issue::new(&model, prf(21), STRENGTH);
    let mut wrong = Vec::new();
    for (what, edits) in EDITS {
        let (mut gaussians, mut random) = (stamped(&model, &issue), Random(5));
        edits.iter().for_each(|edit| edit(&mut gaussians, &mut random));
        let found = gather_asset(&model, &with(&model, gaussians)).expect("gathers");
        wrong.extend(misnamed(what, &found, &best(&gpu, &issue, &found)));
    }
    assert_eq!(wrong, [""; 0]);
}

#[test]
fn copies_in_other_formats_name_themselves() {
    let Some(gpu) = device() else { return };
    let model = demo();
    let issue = Issue::new(&model, prf(22), STRENGTH);
    let mut copy = stamped(&model, &issue);
    reordered(&mut copy, &mut Random(6));
    for export in [Export::Ply, Export::Glb, Export::Spz] {
        let path = Path::new("leak").with_extension(export.extension());
        let leaked = Model::parse(&path, export.encode(&path, &copy).expect("encodes")).expect("opens");
        let found = gather_asset(&model, &leaked).expect("gathers");
        assert_eq!(misnamed(export.extension(), &found, &best(&gpu, &issue, &found)), None);
    }
}

#[test]
fn nobody_is_named_by_an_unmarked_asset_or_another_one() {
    let Some(gpu) = device() else { return };
    let model = demo();
    let issue = Issue::new(&model, prf(23), STRENGTH);
    let foreign = stamped(&model, &Issue::new(&model, prf(24), STRENGTH));
    for (what, gaussians) in [("unmarked", model.gaussians.clone()), ("of another issue", foreign)] {
        for edits in [&[][..], &[noisy as Edit], &ALL] {
            let (mut gaussians, mut random) = (gaussians.clone(), Random(7));
            edits.iter().for_each(|edit| edit(&mut gaussians, &mut random));
            let found = gather_asset(&model, &with(&model, gaussians)).expect("gathers");
            assert!(found.matched > model.gaussians.len() / 2, "{what}: {} splats", found.matched);
            let best = best(&gpu, &issue, &found);
            assert!(best.iter().all(|copy| copy.log_p_family > 1e-3f64.ln()), "{what}: {best:?}");
        }
    }
}

#[test]
fn a_real_capture_is_found_again_in_another_format() {
    let Some(gpu) = device() else { return };
    let Some(path) = shared("data/static/biker.compressed.ply") else { return };
    let model = Model::open(&path).expect("the capture opens");
    let issue = Issue::new(&model, prf(25), STRENGTH);
    for (what, edits) in [("rounded", &[rounded as Edit, reordered][..]), ("all at once", &ALL)] {
        let (mut gaussians, mut random) = (stamped(&model, &issue), Random(8));
        edits.iter().for_each(|edit| edit(&mut gaussians, &mut random));
        let path = Path::new("leak.spz");
        let leaked = Model::parse(path, Export::Spz.encode(path, &gaussians).expect("encodes")).expect("opens");
        let found = gather_asset(&model, &leaked).expect("gathers");
        assert_eq!(misnamed(what, &found, &best(&gpu, &issue, &found)), None);
    }
}

#[test]
fn the_whole_is_put_back_where_it_was() {
    let model = demo();
    let cases: [(&[Edit], f64); 4] = [
        (&[], 0.01),
        (&[reordered], 100.0),
        (&[with_a_floor, |g, r| pruned(g, r, 50), reordered], 0.3),
        (&[restyled, noisy, |g, r| pruned(g, r, 50), reordered], 20.0),
    ];
    for (edits, scale) in cases {
        let (mut gaussians, mut random) = (model.gaussians.clone(), Random(9));
        edits.iter().for_each(|edit| edit(&mut gaussians, &mut random));
        let by = anywhere(scale, &mut random);
        moved(&mut gaussians, &by);
        let found = gather_asset(&model, &with(&model, gaussians)).expect("gathers").similarity;
        // A hundredth of the spacing of splats, of which a hundred stand along the asset.
        assert!((found.scale / by.scale - 1.0).abs() < 1e-4, "{found:?} for {by:?}");
        assert!(found.rotation.angle_between(by.rotation) < 1e-4, "{found:?} for {by:?}");
        assert!(found.translation.distance(by.translation) < 1e-4 * scale, "{found:?} for {by:?}");
    }
}

#[test]
fn little_in_common_is_no_error_and_nothing_is() {
    let model = demo();
    let mut random = Random(10);
    let mut other = model.gaussians.clone();
    let means = random.vec_f32(3 * other.len(), -1.0, 1.0);
    other.means = means.chunks_exact(3).map(|mean| [mean[0], mean[1], mean[2]]).collect();
    let found = gather_asset(&model, &with(&model, other)).expect("no error");
    // Positions at random, most of them where the original is not.
    assert!(found.matched < model.gaussians.len() / 10, "{} splats", found.matched);
    for nowhere in [Gaussians::default(), rows(&model.gaussians, &[0])] {
        let mut nowhere = nowhere;
        nowhere.means.iter_mut().for_each(|mean| mean[1] = f32::NAN);
        for (original, leaked) in [(&model.gaussians, &nowhere), (&nowhere, &model.gaussians)] {
            let refused = gather_asset(&with(&model, original.clone()), &with(&model, leaked.clone()));
            assert!(matches!(refused, Err(EngineError::Usage { .. })), "{refused:?}");
        }
    }
}
