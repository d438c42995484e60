//! Where films were taken from.

mod align;
mod bank;
mod cameras;
mod film;
mod gap;
mod gray;
mod mend;
mod merged;
mod picture;
mod pose;
mod reading;
mod shots;
mod stage;
mod thumbnail;
mod views;
