//! How well copies are told apart: copies are stamped, spoilt, filmed, encoded and traced, with the shipped settings.

pub mod film;
pub mod filmed;
pub mod leak;
pub mod measure;
pub mod owner;
pub mod pages;
pub mod rewritten;
