//! Dates that others put on receipts.

mod authorities;
mod commit;
mod response;
mod root;
mod signature;
mod standing;
mod token;
mod tree;
