//! Twin of `scan/prefix_sum_*`.

/// Exclusive sums modulo 2³² and the total, `[n+1]`.
#[must_use]
pub fn exclusive(data: &[u32]) -> Vec<u32> {
    let mut sums = vec![0];
    let mut total = 0u32;
    for value in data {
        total = total.wrapping_add(*value);
        sums.push(total);
    }
    sums
}
