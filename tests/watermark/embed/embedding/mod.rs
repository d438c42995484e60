//! A whole embedding: its steps, its phases, and what becomes of its settings.

mod control_losses;
mod copies;
mod held_out;
mod rotations;
mod schedule;
mod steps;
