//! Pictures, their gradients, and what both take.

mod golden;
mod models;
