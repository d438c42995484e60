//! image/warp: twin against differences, GPU against the twin, adjoint, turns that are exact, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::image::warp::{Sampling, Warp, backward, forward};
use guard4d_kernels::reference::image::warp as twin;
use guard4d_kernels::shape::ClipShape;

use super::{both_ways, dot, run, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const FILL: [f32; 3] = [0.25, 0.5, 0.75];

fn on_gpu(gpu: &Gpu, clip: ClipShape, warp: &Warp, x: &[f32], v_y: &[f32]) -> [Vec<f32>; 2] {
    both_ways(gpu, x, v_y, |rec, [x, v_y], [y, v_x]| {
        forward(rec, clip, warp, x, y)?;
        backward(rec, clip, warp, v_y, v_x)
    })
}

/// What the twin makes of all frames.
fn on_host(clip: ClipShape, warp: &Warp, x: &[f32], v_y: &[f32]) -> [Vec<f32>; 2] {
    let reads = twin::Reads { map: warp.map, bilinear: warp.sampling == Sampling::Bilinear };
    let (size, frame) = ([clip.height, clip.width], clip.height * clip.width * 4);
    let y = x.chunks_exact(frame).flat_map(|x| twin::forward(x, size, &reads, warp.fill)).collect();
    [y, v_y.chunks_exact(frame).flat_map(|v| twin::backward(v, size, &reads)).collect()]
}

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(8);
    let clip = ClipShape { frames: 1, height: 5, width: 6 };
    for bilinear in [true, false] {
        let map = Warp::rotation(clip, 20.0, Sampling::Nearest, FILL).map;
        let reads = twin::Reads { map, bilinear };
        let (x, v_y) = (random.vec(120, 0.0, 1.0), random.vec(120, -1.0, 1.0));
        let f = |x: &[f64]| dot(&twin::forward(x, [5, 6], &reads, [0.1, 0.2, 0.3]), &v_y);
        let worst = gradcheck(f, &x, &twin::backward(&v_y, [5, 6], &reads));
        assert!(worst < 1e-6, "bilinear {bilinear}: {worst}");
    }
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (frames, height, width) in [(1, 1, 1), (2, 13, 70), (1, 40, 33)] {
        let clip = ClipShape { frames, height, width };
        let mut random = Random(width as u64);
        let x = random.vec_f32(clip.pixels() * 4, 0.0, 1.0);
        let v_y = random.vec_f32(clip.pixels() * 4, -1.0, 1.0);
        for warp in [
            Warp::rotation(clip, 17.0, Sampling::Bilinear, FILL),
            Warp::rotation(clip, -30.0, Sampling::Nearest, FILL),
            Warp::crop(clip, 0.4),
            Warp::mirror(clip),
            Warp { map: [[1.7, 0.2, -3.3], [-0.4, 2.1, 1.1]], sampling: Sampling::Bilinear, fill: FILL },
        ] {
            let (got, want) = (on_gpu(&gpu, clip, &warp, &x, &v_y), on_host(clip, &warp, &x, &v_y));
            // Positions up to 70 are off by 1e-5 in floats, and so is the share of a neighbour; up to 9 readers add up.
            assert_close(&got[0], &want[0], 5e-5, 0.0);
            assert_close(&got[1], &want[1], 2e-4, 0.0);
        }
    }
}

#[test]
fn turns_by_nothing_and_by_half_are_exact_and_the_pictures_hand_is_right() {
    let Some(gpu) = device() else { return };
    let clip = ClipShape { frames: 1, height: 8, width: 8 };
    let x = Random(2).vec_f32(256, 0.0, 1.0);
    let colours = |x: &[f32]| x.chunks_exact(4).map(|v| [v[0], v[1], v[2]]).collect::<Vec<_>>();
    let turned =
        |degrees| colours(&on_gpu(&gpu, clip, &Warp::rotation(clip, degrees, Sampling::Nearest, FILL), &x, &x)[0]);
    assert_eq!(turned(0.0), colours(&x), "no turn");
    let reversed: Vec<_> = colours(&x).into_iter().rev().collect();
    assert_eq!(turned(180.0), reversed, "half a turn");
    // Counterclockwise: the upper right corner goes to the upper left.
    assert_eq!(turned(90.0)[0], colours(&x)[7], "a quarter");
}

#[test]
fn a_warp_of_a_warp_reads_where_both_do_one_after_the_other() {
    let Some(gpu) = device() else { return };
    let clip = ClipShape { frames: 1, height: 9, width: 12 };
    let x = Random(5).vec_f32(clip.pixels() * 4, 0.0, 1.0);
    // Whole steps, so that sampling twice loses nothing; fill comes in from two sides.
    let first = Warp { map: [[1.0, 0.0, 2.0], [0.0, 1.0, -1.0]], sampling: Sampling::Nearest, fill: FILL };
    let second = Warp { map: [[-1.0, 0.0, 9.0], [0.0, 1.0, 0.0]], sampling: Sampling::Nearest, fill: FILL };
    let read = |warp: &Warp, x: &[f32]| on_gpu(&gpu, clip, warp, x, x)[0].clone();
    let (twice, at_once) = (read(&second, &read(&first, &x)), read(&second.of(&first), &x));
    // Where the second stays inside of what the first made.
    for row in 0..clip.height {
        let inside = |data: &[f32]| data[row * clip.width * 4..][..10 * 4].to_vec();
        assert_eq!(inside(&at_once), inside(&twice), "row {row}");
    }
}

#[test]
fn outside_is_fill_and_has_no_gradient() {
    let Some(gpu) = device() else { return };
    let clip = ClipShape { frames: 1, height: 4, width: 4 };
    let away = Warp { map: [[1.0, 0.0, 1e9], [0.0, 1.0, -1e9]], sampling: Sampling::Bilinear, fill: FILL };
    let [y, v_x] = on_gpu(&gpu, clip, &away, &[f32::NAN; 64], &[1.0; 64]);
    assert!(y.chunks_exact(4).all(|p| p == [FILL[0], FILL[1], FILL[2], 0.0]), "{y:?}");
    assert!(v_x.iter().all(|v| *v == 0.0), "{v_x:?}");
}

#[test]
fn poison_reaches_its_readers_only_and_wrong_maps_are_refused() {
    let Some(gpu) = device() else { return };
    let clip = ClipShape { frames: 1, height: 12, width: 10 };
    let warp = Warp { map: [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]], sampling: Sampling::Bilinear, fill: FILL };
    let n = clip.pixels() * 4;
    let clean = Random(4).vec_f32(2 * n, 0.0, 1.0);
    let pixel = (6 * 10 + 5) * 4;
    let places = [pixel, pixel + 3, n + pixel + 1, n + pixel + 3];
    // Halves of two numbers below 1.
    let reached = poison::spread(
        &clean,
        &places,
        (1e-6, 0.0),
        |data| on_gpu(&gpu, clip, &warp, &data[..n], &data[n..]).concat(),
        |data| on_host(clip, &warp, &data[..n], &data[n..]).concat(),
    );
    assert_eq!(reached, [2, 0, 2, 0], "half a pixel of two neighbours, both ways; no fourth channel");
    let flat = Warp { map: [[0.0; 3], [0.0, 1.0, 0.0]], ..warp };
    let (x, mut y) = (upload(&gpu, &clean[..n]), upload(&gpu, &clean[..n]));
    run(&gpu, |rec| {
        let refused = forward(rec, clip, &flat, &x, &mut y);
        assert!(matches!(refused, Err(KernelError::Shape { buffer: "map", .. })), "{refused:?}");
        Ok(())
    });
}
