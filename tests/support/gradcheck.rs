//! Central differences in f64 against an analytic gradient.

/// Worst `|numeric - grad| / (1 + |grad|)` over all inputs, infinite when anything is NaN.
pub(crate) fn gradcheck(f: impl Fn(&[f64]) -> f64, x: &[f64], grad: &[f64]) -> f64 {
    const EPS: f64 = 1e-5; // error of the difference ~ EPS^2 f''' + 1e-16 / EPS: about 1e-10
    assert_eq!(x.len(), grad.len(), "one gradient entry per input");
    let mut probe = x.to_vec();
    let mut worst = 0.0f64;
    for i in 0..x.len() {
        probe[i] = x[i] + EPS;
        let up = f(&probe);
        probe[i] = x[i] - EPS;
        let down = f(&probe);
        probe[i] = x[i];
        let error = ((up - down) / (2.0 * EPS) - grad[i]).abs() / (1.0 + grad[i].abs());
        worst = if error.is_nan() { f64::INFINITY } else { worst.max(error) };
    }
    worst
}

#[test]
fn right_wrong_and_nan_gradients_are_told_apart() {
    let f = |x: &[f64]| x[0] * x[0] * x[1];
    let x = [1.5, -2.0];
    assert!(gradcheck(f, &x, &[-6.0, 2.25]) < 1e-8, "right");
    assert!(gradcheck(f, &x, &[-6.0, 2.0]) > 1e-3, "wrong");
    assert!(gradcheck(f, &x, &[f64::NAN, 2.25]).is_infinite(), "NaN");
}
