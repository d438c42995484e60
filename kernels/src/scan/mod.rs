//! Prefix sums and sorting.

pub mod prefix_sum;
pub mod radix_sort;
