//! One bad number in good data: the device must spread it as the twin does, and no further.

use super::close::worst_ratio;

/// Not a number, both infinities, and a number below the normal range.
const BAD: [f32; 4] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40];

/// Puts every bad number into each of `places` of `clean`, one at a time, and fails unless all outputs of `gpu` are
/// those of `twin`: both NaN, the same infinity, or within `atol + rtol |want|`. An output that no bad number in a
/// place changes in the twin must keep its bits on the device. Returns how many outputs a NaN in each place reaches.
#[track_caller]
pub(crate) fn spread(
    clean: &[f32],
    places: &[usize],
    tolerance: (f32, f32),
    gpu: impl Fn(&[f32]) -> Vec<f32>,
    twin: impl Fn(&[f32]) -> Vec<f32>,
) -> Vec<usize> {
    match try_spread(clean, places, tolerance, &|x| (gpu(x), twin(x))) {
        Ok(reach) => reach,
        Err(fault) => panic!("{fault}"),
    }
}

/// Outputs of the device and of the twin.
type Pair = (Vec<f32>, Vec<f32>);

fn try_spread(
    clean: &[f32],
    places: &[usize],
    tolerance: (f32, f32),
    run: &dyn Fn(&[f32]) -> Pair,
) -> Result<Vec<usize>, String> {
    let before = run(clean);
    agree(&before, tolerance).map_err(|e| format!("without poison: {e}"))?;
    if !before.1.iter().all(|v| v.is_finite()) {
        return Err("the outputs without poison are not finite".to_owned());
    }
    let mut reach = Vec::new();
    for &at in places {
        let mut runs = Vec::new();
        for bad in BAD {
            let mut data = clean.to_vec();
            data[at] = bad;
            let mut after = run(&data);
            let mut agreed = agree(&after, tolerance);
            if bad.is_subnormal() && agreed.is_err() {
                // A driver may also read it as zero, and then compares it as zero: what the twin makes of that counts
                // too.
                data[at] = 0.0;
                after.1 = run(&data).1;
                agreed = agreed.or_else(|e| agree(&after, tolerance).map_err(|_| e));
            }
            agreed.map_err(|e| format!("{bad:e} at {at}: {e}"))?;
            runs.push(after);
        }
        reach.push(runs[0].0.iter().filter(|v| v.is_nan()).count());
        for i in 0..before.1.len() {
            let same = |get: fn(&Pair) -> &[f32]| runs.iter().all(|r| get(r)[i].to_bits() == get(&before)[i].to_bits());
            if same(|r| &r.1) && !same(|r| &r.0) {
                let got: Vec<_> = runs.iter().map(|r| r.0[i]).collect();
                return Err(format!("poison at {at} leaks into output {i}: {} becomes {got:?}", before.0[i]));
            }
        }
    }
    Ok(reach)
}

/// Whether all outputs are of the same kind and close.
fn agree((got, want): &Pair, (atol, rtol): (f32, f32)) -> Result<(), String> {
    // Vulkan lets a driver flush denormals to zero: that is off by less than the smallest normal number.
    let atol = atol.max(f32::MIN_POSITIVE);
    if got.len() != want.len() {
        return Err(format!("{} outputs, expected {}", got.len(), want.len()));
    }
    let close = |g: f32, w: f32| g.is_nan() && w.is_nan() || worst_ratio(&[g], &[w], atol, rtol) <= 1.0;
    let wrong: Vec<_> = (0..want.len()).filter(|&i| !close(got[i], want[i])).collect();
    match wrong.first() {
        None => Ok(()),
        Some(&i) => Err(format!("{} outputs differ, first {i}: {:e}, expected {:e}", wrong.len(), got[i], want[i])),
    }
}

#[test]
fn hidden_leaked_and_turned_poison_are_told_apart() {
    let clean = [1.0, 2.0];
    let twin = |x: &[f32]| vec![x[0] * 2.0, x[1]];
    let check = |gpu: &dyn Fn(&[f32]) -> Vec<f32>| try_spread(&clean, &[0], (1e-6, 0.0), &|x| (gpu(x), twin(x)));
    assert_eq!(check(&twin), Ok(vec![1]), "the twin itself");
    let flush = |x: &[f32]| if x[0].is_subnormal() { vec![0.0, x[1]] } else { twin(x) };
    assert_eq!(check(&flush), Ok(vec![1]), "a flushed denormal");
    let opens = |x: &[f32]| vec![if x[0] > 0.0 { 3.0 } else { x[0] * 0.0 }, x[1]];
    let reads_zero = |x: &[f32]| opens(&[if x[0].is_subnormal() { 0.0 } else { x[0] }, x[1]]);
    assert_eq!(try_spread(&clean, &[0], (1e-6, 0.0), &|x| (reads_zero(x), opens(x))), Ok(vec![1]), "compared as zero");
    let reads_one =
        |x: &[f32]| opens(&[if x[0].is_subnormal() { -1.0 } else { x[0] }, x[1] + x[0].abs().min(1.0) - 1.0]);
    assert!(
        try_spread(&clean, &[0], (1e-6, 0.0), &|x| (reads_one(x), opens(x))).is_err(),
        "compared as something else"
    );
    let hides = |x: &[f32]| vec![(x[0] * 2.0).max(-9.0), x[1]];
    assert!(check(&hides).is_err_and(|e| e.contains("NaN at 0")), "a hidden NaN");
    let turns = |x: &[f32]| vec![if x[0].is_infinite() { -x[0] } else { 2.0 * x[0] }, x[1]];
    assert!(check(&turns).is_err_and(|e| e.contains("inf at 0")), "the other infinity");
    let leaks = |x: &[f32]| vec![x[0] * 2.0, if x[0].is_nan() { x[1].next_up() } else { x[1] }];
    assert!(check(&leaks).is_err_and(|e| e.contains("leaks into output 1")), "a changed bit elsewhere");
    let grows = |x: &[f32]| vec![x[0] * 2.0 + x[0].abs().min(1.0) - 1.0, x[1]];
    assert!(check(&grows).is_err_and(|e| e.contains("1e-40 at 0")), "a denormal that changes the result");
    let short = |x: &[f32]| vec![x[0] * 2.0];
    assert!(check(&short).is_err_and(|e| e.contains("1 outputs")), "lengths");
    let never = |x: &[f32]| (vec![x[0] / 0.0], vec![x[0] / 0.0]);
    assert!(try_spread(&clean, &[0], (0.0, 0.0), &never).is_err(), "outputs that are bad from the start");
}
