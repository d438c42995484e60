//! The extractor and its parts.

mod calibration;
mod pretrained;
mod reader;
mod scatter;
mod tmsd;
