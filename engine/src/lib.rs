//! Scenes, rendering, CLIP, marks and evidence of guard4d.
//!
//! The rooms stand in one order, and each imports only those before it: `error`, `device`, `base`, `scene`, `media`,
//! `render`, `networks`, `picture`, `evidence`, `watermark`, `fingerprint`, `locate`, `release`, `detect`, `farm`.
#![forbid(unsafe_code)]

pub mod base;
pub mod detect;
pub mod device;
pub mod error;
pub mod evidence;
pub mod farm;
pub mod fingerprint;
pub mod locate;
pub mod media;
pub mod networks;
pub mod picture;
pub mod release;
pub mod render;
pub mod scene;
pub mod watermark;

pub use error::EngineError;
