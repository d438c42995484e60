//! Where films were taken from.

mod align;
mod bank;
mod gray;
mod pose;
