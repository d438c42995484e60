//! Where films were taken from.

mod align;
mod bank;
mod cameras;
mod film;
mod gap;
mod gray;
mod picture;
mod pose;
mod shots;
mod thumbnail;
