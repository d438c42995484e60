//! Yardsticks: what the device can do at best, for the benchmarks to compare with.

pub mod mul_add;
