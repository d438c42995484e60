//! `guard4d demo`: the whole way on the embedded scene, with nothing to download.

mod copies;
mod run;
mod wrong_key;

pub(crate) use run::{DemoArgs, run};
