//! The extractor: clip → R (TMSD) → CLIP's image tower → calibration → the key's decoder → one logit per bit.

pub mod calibration;
pub mod content;
pub mod features;
pub mod preprocess;
pub mod pretrained;
pub mod reader;
pub mod rotation;
pub mod scatter;
pub mod tmsd;
pub mod weights;
