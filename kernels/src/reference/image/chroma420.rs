//! Twin of `image/chroma420_apply`.

use crate::reference::real::Real;

/// B P A x of one frame `[H,W,4]`, fourth channel 0; P averages the second and third component over 2×2 quads.
pub fn apply<R: Real>(x: &[R], [height, width]: [usize; 2], [a, b]: [[[R; 3]; 3]; 2]) -> Vec<R> {
    let at = |row: usize, column: usize| &x[(row * width + column) * 4..][..3];
    let product = |m: [[R; 3]; 3], v: &[R]| m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
    let mut y = Vec::with_capacity(x.len());
    for row in 0..height {
        for column in 0..width {
            let mut t = product(a, at(row, column));
            let (top, left) = (row / 2 * 2, column / 2 * 2);
            let quad: Vec<[R; 3]> = (top..height.min(top + 2))
                .flat_map(|r| (left..width.min(left + 2)).map(move |c| (r, c)))
                .map(|(r, c)| product(a, at(r, c)))
                .collect();
            for k in 1..3 {
                let sum = quad.iter().fold(R::of(0.0), |sum, v| sum + v[k]);
                t[k] = sum / R::of(quad.len() as f64);
            }
            y.extend(product(b, &t));
            y.push(R::of(0.0));
        }
    }
    y
}
