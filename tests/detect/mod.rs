//! The questions that suspects are asked.

mod exhibit;
mod opened;
mod request;
mod verify_cache;
