//! Twins of `scan`.

pub mod prefix_sum;
pub mod radix_sort;
