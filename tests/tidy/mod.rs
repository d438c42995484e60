//! House rules that the compiler cannot see; `ARCHITECTURE.md` says why each exists.
//!
//! Every rule collects all offences before it fails, and is itself tried on text that breaks it.

mod imports;
mod kernels;
mod mirror;
mod nan;
mod parameters;
mod rooms;
pub(crate) mod sources;
mod text;
mod words;
