//! What the message says where film and original are compared.

use serde::Serialize;

use crate::evidence::id_code::SearchedP;

/// What the message says where each frame is compared with the original's from the same camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ComparedMessage {
    /// Bits that match.
    pub matches: u32,
    /// Bits compared.
    pub num_bits: u32,
    /// Frames that were compared.
    pub frames: u32,
    /// The best id, if ids are asked for.
    pub id: Option<u32>,
    /// Chance that a message agrees so well, times what it was chosen from.
    pub p_value: SearchedP,
    /// Whether it alone proves it by the receipt's rule.
    pub proves: bool,
}
