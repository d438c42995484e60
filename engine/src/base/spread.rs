//! A few of many, evenly spread.

/// Which of `len` stand for all of them: the middles of `count` equal parts, or of as many as there are.
pub fn spread(len: usize, count: usize) -> impl Iterator<Item = usize> {
    let count = count.min(len);
    (0..count).map(move |part| (2 * part + 1) * len / (2 * count))
}
