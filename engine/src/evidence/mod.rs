//! From the bits that were read to a verdict, with exact statistics. Nothing here needs a device.

pub mod claim;
pub mod control;
pub mod extractor_mode;
pub mod id_code;
pub mod judgement;
pub mod message;
pub mod negative_controls;
pub mod other_keys;
pub mod payload;
pub mod per_bit;
pub mod reading;
pub mod reason;
pub mod score_tail;
pub mod statistics;
pub mod thresholds;
