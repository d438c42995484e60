//! Scene loading: files that other programs write, files that nobody should write, and what is written back.

use guard4d_engine::error::EngineError;

mod camera;
mod cfg_args;
mod demo;
mod ellipsoid;
mod formats;
mod gaussians;
mod model;
pub(crate) mod ply;
mod procedural;
mod pth;
mod recognise;
mod sequence;
mod source;

/// Field, got and expected of a [`EngineError::BadData`]; its exit code is checked on the way.
fn bad_data<T: std::fmt::Debug>(result: Result<T, EngineError>) -> [String; 3] {
    let error = result.expect_err("the input is bad");
    assert_eq!(error.exit_code(), 65, "exit code of bad data: {error}");
    match error {
        EngineError::BadData { field, got, expected, .. } => [field, got, expected],
        other => panic!("not bad data: {other}"),
    }
}

/// Asserts that the message of a bad-data error holds all of `words`.
fn assert_refused<T: std::fmt::Debug>(result: Result<T, EngineError>, words: &[&str]) {
    let message = bad_data(result).join(" | ");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in `{message}`");
    }
}
