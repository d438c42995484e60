//! image/resize: twin against differences and PyTorch, GPU against the twin, adjoint, extremes.

use guard4d_kernels::KernelError;
use guard4d_kernels::image::resize::{Blur, ImageSize, Onward, Region, ResizePlan, backward, forward};
use guard4d_kernels::reference::image::{gate, resize as twin};

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::golden::Golden;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const GOLDEN_CASES: [&str; 4] = ["down", "up", "one", "mixed"];

fn size([height, width]: [usize; 2]) -> ImageSize {
    ImageSize { height, width }
}

/// `(y, v_x)` on the device.
fn on_gpu(gpu: &Gpu, [from, to]: [[usize; 2]; 2], x: &[f32], v_y: &[f32], onward: Onward<'_>) -> [Vec<f32>; 2] {
    let plan = ResizePlan::new(gpu, size(from), size(to)).expect("plan");
    let mut scratch = plan.scratch(gpu, x.len() / (from[0] * from[1] * 4)).expect("scratch");
    let (x, v_y) = (upload(gpu, x), upload(gpu, v_y));
    let mut y = unwritten(gpu, v_y.len());
    let mut v_x = unwritten(gpu, x.len());
    run(gpu, |rec| {
        forward(rec, &plan, &x, &mut y, &mut scratch)?;
        backward(rec, &plan, &v_y, &mut v_x, onward, &mut scratch)
    });
    [y.read().expect("read"), v_x.read().expect("read")]
}

#[test]
fn twin_gradient_matches_differences() {
    for (from, to) in [([5, 7], [2, 3]), ([2, 3], [5, 4])] {
        let mut random = Random(3);
        let x = random.vec(from[0] * from[1] * 4, 0.0, 1.0);
        let v_y = random.vec(to[0] * to[1] * 4, -1.0, 1.0);
        // The fourth channel of the output is zero, so its gradient reaches nothing.
        let grad = twin::backward(&v_y, from, to);
        let worst = gradcheck(|x| dot(&twin::forward(x, from, to), &v_y), &x, &grad);
        assert!(worst < 1e-6, "{from:?} to {to:?}: {worst}");
    }
}

#[test]
fn twin_and_gpu_match_pytorch() {
    let golden = Golden::load("resize");
    for case in GOLDEN_CASES {
        let (from, to) = (golden.shape(&format!("{case}.x")), golden.shape(&format!("{case}.y")));
        let (from, to) = ([from[1], from[2]], [to[1], to[2]]);
        let [x, y, v_y, v_x] = ["x", "y", "v_y", "v_x"].map(|n| golden.f32(&format!("{case}.{n}")));
        // Weights are f32 sums of up to 14 triangle values on either side: about 1e-6.
        assert_close(&twin::forward(&x, from, to), &y, 2e-6, 1e-6);
        assert_close(&twin::backward(&v_y, from, to), &v_x, 4e-6, 1e-6);
        let Some(gpu) = device() else { continue };
        let got = on_gpu(&gpu, [from, to], &x, &v_y, Onward::default());
        assert_close(&got[0], &y, 2e-6, 1e-6);
        assert_close(&got[1], &v_x, 4e-6, 1e-6);
    }
}

#[test]
fn gpu_follows_the_twin_adds_and_clamps() {
    let Some(gpu) = device() else { return };
    for (frames, from, to) in [
        (1, [1, 1], [1, 1]),
        (2, [13, 70], [5, 9]),
        (3, [8, 8], [8, 8]),
        (1, [40, 3], [6, 130]),
        (1, [100, 66], [7, 3]),
    ] {
        let mut random = Random(frames as u64);
        let x = random.vec_f32(frames * from[0] * from[1] * 4, 0.0, 1.0);
        let v_y = random.vec_f32(frames * to[0] * to[1] * 4, -1.0, 1.0);
        let plus = random.vec_f32(x.len(), -1.0, 1.0);
        let mut clamped = random.vec_f32(x.len(), -0.5, 1.5);
        clamped[..4].copy_from_slice(&[0.0, 1.0, f32::NAN, 0.0]);
        let (plus_there, clamped_there) = (upload(&gpu, &plus), upload(&gpu, &clamped));
        let onward = Onward { plus: Some(&plus_there), clamped: Some(&clamped_there) };
        let [y, v_x] = on_gpu(&gpu, [from, to], &x, &v_y, onward);
        // Two passes of short sums against one; rounding only.
        assert_close(&y, &twin::forward(&x, from, to), 2e-6, 1e-6);
        let mut want = twin::backward(&v_y, from, to);
        let added = want.iter_mut().zip(plus.iter().zip(&clamped)).enumerate();
        added.for_each(|(i, (v, (p, c)))| *v = if i % 4 < 3 { gate(*c, *v + p) } else { 0.0 });
        assert_close(&v_x, &want, 2e-6, 1e-6);
    }
}

#[test]
fn same_size_is_the_identity() {
    let Some(gpu) = device() else { return };
    let x = Random(1).vec_f32(6 * 9 * 4, 0.0, 1.0);
    let [y, v_x] = on_gpu(&gpu, [[6, 9], [6, 9]], &x, &x, Onward::default());
    let want: Vec<f32> = x.iter().enumerate().map(|(i, v)| if i % 4 < 3 { *v } else { 0.0 }).collect();
    assert_eq!(y, want, "resizing to the same size copies colours");
    assert_eq!(v_x, want, "and so does its adjoint");
}

#[test]
fn a_blur_follows_the_twin_keeps_grey_and_is_adjoint() {
    let Some(gpu) = device() else { return };
    for ([height, width], blur) in [
        ([9, 14], Blur { sigma: 0.8, radius: 1 }),
        ([20, 7], Blur { sigma: 2.0, radius: 6 }),
        ([1, 3], Blur { sigma: 1.5, radius: 5 }),
    ] {
        let shape = [height, width];
        let plan = ResizePlan::blur(&gpu, size(shape), blur).expect("plan");
        let mut scratch = plan.scratch(&gpu, 1).expect("scratch");
        let mut random = Random(width as u64);
        let n = height * width * 4;
        let (x, v_y) = (random.vec_f32(n, 0.0, 1.0), random.vec_f32(n, -1.0, 1.0));
        let [y, v_x, grey] = {
            let [x, v_y, even] = [&x, &v_y, &vec![0.5; n]].map(|data| upload(&gpu, data));
            let mut out = [0; 3].map(|_| unwritten(&gpu, n));
            let [y, v_x, grey] = &mut out;
            run(&gpu, |rec| {
                forward(rec, &plan, &x, y, &mut scratch)?;
                forward(rec, &plan, &even, grey, &mut scratch)?;
                backward(rec, &plan, &v_y, v_x, Onward::default(), &mut scratch)
            });
            out.map(|buffer| buffer.read().expect("read"))
        };
        let axes = shape.map(|n| twin::blur_matrix::<f32>(n, blur.sigma, blur.radius));
        // Two passes of up to 13 products each.
        assert_close(&y, &twin::filter(&x, shape, shape, &axes[0], &axes[1]), 2e-6, 1e-6);
        assert!(grey.chunks_exact(4).all(|p| p[..3].iter().all(|v| (v - 0.5).abs() < 1e-6)), "{blur:?} keeps grey");
        let product = |a: &[f32], b: &[f32]| -> f64 {
            a.iter().zip(b).enumerate().filter(|(i, _)| i % 4 < 3).map(|(_, (a, b))| f64::from(a * b)).sum()
        };
        // Sums of a few hundred products of numbers up to 1, each off by 1e-6.
        assert!((product(&y, &v_y) - product(&x, &v_x)).abs() < 1e-4, "{blur:?}: not adjoint");
    }
    let refused = ResizePlan::blur(&gpu, size([4, 4]), Blur { sigma: f64::NAN, radius: 1 });
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "blur", .. })), "{refused:?}");
}

#[test]
fn a_region_for_each_frame_follows_the_twin_reaches_beyond_the_picture_and_is_adjoint() {
    let Some(gpu) = device() else { return };
    let (from, to) = ([12, 17], [5, 6]);
    // A part, more than all, a part enlarged, nothing but the outside, and all of it.
    let regions = [
        Region { x: 3.2, y: 1.5, width: 8.0, height: 7.3 },
        Region { x: -5.5, y: -3.0, width: 30.0, height: 20.0 },
        Region { x: 4.0, y: 5.0, width: 2.5, height: 0.5 },
        Region { x: -40.0, y: 30.0, width: 10.0, height: 10.0 },
        Region::whole(size(from)),
    ];
    let plan = ResizePlan::regions(&gpu, size(from), size(to), &regions).expect("plan");
    let frames = regions.len();
    let (large, small) = (from[0] * from[1] * 4, to[0] * to[1] * 4);
    let mut random = Random(9);
    let x = random.vec_f32(frames * large, 0.0, 1.0);
    let v_y = random.vec_f32(frames * small, -1.0, 1.0);
    let mut scratch = plan.scratch(&gpu, frames).expect("scratch");
    let (mut y, mut v_x) = (unwritten(&gpu, v_y.len()), unwritten(&gpu, x.len()));
    let (x_there, v_y_there) = (upload(&gpu, &x), upload(&gpu, &v_y));
    run(&gpu, |rec| {
        forward(rec, &plan, &x_there, &mut y, &mut scratch)?;
        backward(rec, &plan, &v_y_there, &mut v_x, Onward::default(), &mut scratch)
    });
    let (y, v_x) = (y.read().expect("read"), v_x.read().expect("read"));
    for (f, region) in regions.iter().enumerate() {
        let rows = twin::part_matrix::<f32>(from[0], to[0], [region.y, region.height]);
        let columns = twin::part_matrix::<f32>(from[1], to[1], [region.x, region.width]);
        let want = twin::filter(&x[f * large..][..large], from, to, &rows, &columns);
        // Two passes of short sums against one; rounding only.
        assert_close(&y[f * small..][..small], &want, 2e-6, 1e-6);
    }
    let whole = twin::forward(&x[4 * large..], from, to);
    assert_close(&y[4 * small..], &whole, 2e-6, 1e-6);
    let product = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).enumerate().filter(|(i, _)| i % 4 < 3).map(|(_, (a, b))| f64::from(a * b)).sum()
    };
    // Sums of a few hundred products of numbers up to 1, each off by 1e-6.
    assert!((product(&y, &v_y) - product(&x, &v_x)).abs() < 1e-4, "not adjoint");
    for bad in [vec![], vec![Region { width: 0.0, ..regions[0] }], vec![Region { x: f64::NAN, ..regions[0] }]] {
        let refused = ResizePlan::regions(&gpu, size(from), size(to), &bad);
        assert!(matches!(refused, Err(KernelError::Shape { buffer: "regions", .. })), "{refused:?}");
    }
    let mut rec = gpu.recorder().expect("recorder");
    let (one, mut small_one) = (upload(&gpu, &x[..large]), unwritten(&gpu, small));
    let refused = forward(&mut rec, &plan, &one, &mut small_one, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { .. })), "one frame for five regions: {refused:?}");
}

#[test]
fn poison_stays_in_its_window() {
    let Some(gpu) = device() else { return };
    let (from, to) = ([32, 28], [5, 8]);
    let split = from[0] * from[1] * 4;
    let clean = Random(2).vec_f32(split + to[0] * to[1] * 4, 0.0, 1.0);
    let on_gpu = |data: &[f32]| on_gpu(&gpu, [from, to], &data[..split], &data[split..], Onward::default()).concat();
    let on_host =
        |data: &[f32]| [twin::forward(&data[..split], from, to), twin::backward(&data[split..], from, to)].concat();
    let (pixel, small) = (16 * from[1] + 14, 2 * to[1] + 3);
    let places = [pixel * 4 + 1, pixel * 4 + 3, split + small * 4 + 2, split + small * 4 + 3];
    // Two passes of short sums against one; rounding only.
    let reach = poison::spread(&clean, &places, (4e-6, 1e-6), on_gpu, on_host);
    let reaches = |matrix: Vec<f32>, one: &dyn Fn(usize) -> bool| {
        matrix.iter().enumerate().filter(|(i, w)| one(*i) && **w != 0.0).count()
    };
    let [rows, columns] = [0, 1].map(|k| twin::matrix::<f32>(from[k], to[k]));
    let read_by = reaches(rows.clone(), &|i| i % from[0] == 16) * reaches(columns.clone(), &|i| i % from[1] == 14);
    let reads = reaches(rows, &|i| i / from[0] == 2) * reaches(columns, &|i| i / from[1] == 3);
    assert_eq!(reach, [read_by, 0, reads, 0], "the pixels of its window; no fourth channel is read");
}

#[test]
fn wrong_shapes_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let refused = ResizePlan::new(&gpu, size([0, 4]), size([2, 2]));
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "from", .. })), "no rows: {refused:?}");
    let plan = ResizePlan::new(&gpu, size([4, 4]), size([2, 2])).expect("plan");
    let x = upload(&gpu, &[0.0; 64]);
    let mut short = upload(&gpu, &[0.0; 12]);
    let mut scratch = plan.scratch(&gpu, 1).expect("scratch");
    let mut rec = gpu.recorder().expect("recorder");
    let refused = forward(&mut rec, &plan, &x, &mut short, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "y", .. })), "short output: {refused:?}");
    let [y, v_x] = on_gpu(&gpu, [[4, 4], [2, 2]], &[], &[], Onward::default());
    assert!(y.is_empty() && v_x.is_empty(), "no frame, no pixel");
}
