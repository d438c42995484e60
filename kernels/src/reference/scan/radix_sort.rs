//! Twin of `scan/radix_sort_*`.

/// Sorts pairs (key, value) by the low `bits` of the key, ties in their order.
#[must_use]
pub fn sort(pairs: &[(u32, u32)], bits: u32) -> Vec<(u32, u32)> {
    let mask = u32::MAX >> (u32::BITS - bits);
    let mut sorted = pairs.to_vec();
    sorted.sort_by_key(|(key, _)| key & mask);
    sorted
}
