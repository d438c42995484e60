//! The extractor and its parts.

mod calibration;
mod content;
mod pretrained;
mod reader;
mod scatter;
mod tmsd;
