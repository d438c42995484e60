//! Benchmarks of the kernels and of the embedding step, in device time.

fn main() {}
