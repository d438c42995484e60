//! The questions that suspects are asked.

mod opened;
mod request;
