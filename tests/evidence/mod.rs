//! From bits to verdicts.

mod id_code;
mod judgement;
mod message;
mod per_bit;
mod score_tail;
mod statistics;
