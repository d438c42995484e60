//! How well copies are told apart: copies are stamped, spoilt, filmed, encoded and traced, with the shipped settings.

pub mod film;
pub mod leak;
pub mod measure;
