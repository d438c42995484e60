//! The commands: of each, its arguments and what it does.

pub(crate) mod attack;
pub(crate) mod commit;
pub(crate) mod completions;
pub(crate) mod convert;
pub(crate) mod demo;
pub(crate) mod devices;
pub(crate) mod disclose;
pub(crate) mod embed;
pub(crate) mod farm;
pub(crate) mod inspect;
pub(crate) mod keygen;
pub(crate) mod lab;
pub(crate) mod ledger;
pub(crate) mod locate;
pub(crate) mod man;
pub(crate) mod reference;
pub(crate) mod render;
pub(crate) mod stamp;
pub(crate) mod timestamp;
pub(crate) mod trace;
pub(crate) mod undo;
pub(crate) mod verify;
