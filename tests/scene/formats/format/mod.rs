//! Formats as they are told apart: files of other tools, damaged ones, and all that is written here.

mod damaged;
mod foreign;
mod interop;
mod round_trips;
