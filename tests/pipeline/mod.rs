//! Several rooms together, from one end to the other.

mod conventions;
mod delivery;
mod false_claims;
mod p_value_chart;
mod unseen_films;
