//! How well films of unknown cameras are located: drawn at random, filmed, encoded, found, compared.

pub mod attack;
pub mod film;
pub mod measure;
pub mod pages;
pub mod picture;
mod screen;
