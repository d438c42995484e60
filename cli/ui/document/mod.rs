//! Pages for people, each one file that needs no other and no network: a verdict, for whoever has to judge it, whose
//! copy leaked, and how a farm stands.

mod chart;
pub(crate) mod farm;
mod films;
mod page;
mod readings;
mod record;
mod text;
mod trace_page;
mod verdict;
mod verdict_page;

pub(crate) use record::Repeat;
pub(crate) use trace_page::{Part, TraceDocument};
pub(crate) use verdict_page::Document;
