//! Who says when: dates that others put on receipts.
//!
//! A receipt's commitment, or the one root of many commitments, is stamped by a time-stamping authority as RFC 3161
//! says. Nothing here speaks to a network: a request goes to a file, and the authority's response comes from one.

pub mod authorities;
mod certificate;
pub mod commit;
mod fault;
pub mod proof;
pub mod request;
pub mod response;
pub mod root;
mod signature;
pub mod standing;
pub mod subject;
pub mod token;
pub mod tree;
mod tst_info;
