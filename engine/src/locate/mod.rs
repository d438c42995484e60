//! From where, when and through which lens a film of an asset was taken, as the film and the unmarked asset say alone.
//! No key takes part, so that whatever is found, errors included, says the same of every mark.

pub mod align;
pub mod bank;
pub mod cameras;
mod exposure;
pub mod film;
pub mod finding;
pub mod gap;
pub mod gray;
pub mod making;
pub mod mend;
pub mod merged;
pub mod picture;
pub mod pose;
pub mod reading;
pub mod search;
mod settle;
pub mod shots;
pub mod so_far;
pub mod stage;
pub mod thumbnail;
pub mod views;
mod work;
