//! A verdict as a document: one page for whoever has to judge it, which needs no other file and no network.

mod chart;
mod films;
mod page;
mod readings;
mod record;
mod text;
mod verdict;

pub(crate) use page::Document;
pub(crate) use record::Repeat;
