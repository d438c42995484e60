//! The `guard4d` command.

fn main() {}
