//! What several commands do by the flags they share: open devices and models, read and write films.

pub(crate) mod device;
pub(crate) mod farm_job;
pub(crate) mod film;
pub(crate) mod locator;
pub(crate) mod media;
pub(crate) mod model;
pub(crate) mod session;
pub(crate) mod suspects;
pub(crate) mod views;
pub(crate) mod visible;
