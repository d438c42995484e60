//! The questions that suspect clips are asked: whether the owner's mark is there, and how sure that is.

mod choice;
mod clip_reader;
pub mod compared_message;
pub mod comparer;
pub mod controls;
pub mod exhibit;
pub mod free_part;
pub mod gathered;
mod opened;
pub mod own_clips;
pub mod owner_chips;
pub mod report;
pub mod request;
pub mod sought;
pub mod suspect;
pub mod trace;
pub mod verify;
pub mod verify_cache;
mod with_original;
