//! The questions that suspect clips are asked: whether the owner's mark is there, and how sure that is.

mod choice;
mod clip_reader;
pub mod controls;
mod opened;
pub mod report;
pub mod sought;
pub mod suspect;
pub mod verify;
