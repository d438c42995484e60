//! Tests of `scan`.

mod prefix_sum;
mod radix_sort;
