//! What leaves the house, and what is kept: marked models, receipts, measurements, undo.

pub mod classes;
pub mod dating;
pub mod delivery;
pub mod disclosure;
pub mod evaluate;
pub mod gate;
pub mod issue_key;
pub mod issue_root;
pub mod ledger;
pub mod owner_chips;
pub mod receipt;
pub mod recipients;
pub mod stamping;
pub mod undo;
