//! Flags that several commands share, as data: what they ask for is done elsewhere.

pub(crate) mod common;
pub(crate) mod device;
pub(crate) mod film;
pub(crate) mod frames;
pub(crate) mod near;
pub(crate) mod overwrite;
pub(crate) mod passphrase;
pub(crate) mod size;
pub(crate) mod trust;
pub(crate) mod views;
