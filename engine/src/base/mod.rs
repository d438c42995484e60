//! The ground floor: files, hashes, randomness, numbers. Nothing here knows what a scene or a mark is.

pub mod checkpoint;
pub mod digest;
pub mod files;
pub mod held;
pub mod json;
pub mod ledger;
pub mod matrix;
pub mod natural;
pub mod numbers;
pub mod observer;
pub mod output;
pub mod pipelines;
pub mod prf;
pub mod rotation;
pub mod schedule;
pub mod signature;
pub mod spread;
pub mod tensor_file;
