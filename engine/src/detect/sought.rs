//! What clips are asked for, and what the receipt has promised of it.

use std::path::Path;

use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::evidence::id_code::{IdBits, IdCode};
use crate::evidence::message::Message;
use crate::evidence::payload::Payload;
use crate::release::receipt::Receipt;
use crate::watermark::key::owner_key::Key;

/// What clips are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sought {
    /// This message.
    Message(Message),
    /// This id; what id fits best is told beside it.
    Id {
        /// Its code.
        code: IdCode,
        /// Id claimed.
        id: u32,
    },
    /// Whichever id fits best. It may be another than the receipt's, for one key can mark many copies.
    AnyId(IdCode),
}

impl Sought {
    /// Reads what [`Payload::parse`] reads, or `id:12` or `id:16` alone for whichever id fits best, for `key`.
    ///
    /// # Errors
    /// Those of [`Payload::parse`].
    pub fn parse(text: &str, key: &Key) -> Result<Self, EngineError> {
        let num_bits = key.num_bits();
        if let Some(id_bits) = IdBits::parse(text) {
            return Ok(Self::AnyId(IdCode::new(id_bits, num_bits)?));
        }
        Ok(match Payload::parse(text, num_bits)? {
            Payload::Id { code, id } => Self::Id { code, id },
            payload => Self::Message(payload.message(&key.prf())?),
        })
    }

    /// What a receipt is about: ids if it is for one, else the key's own message.
    fn by_default(receipt: &Receipt, key: &Key) -> Result<Self, EngineError> {
        Ok(match receipt.body.promise.payload {
            Some(id_bits) => Self::AnyId(IdCode::new(id_bits, key.num_bits())?),
            None => Self::Message(key.own_message()),
        })
    }
}

/// What the receipt commits to, as far as the question knows it.
pub(super) struct Promised {
    message: Message,
    id: Option<PromisedId>,
}

/// A promised message that stands for an id.
#[derive(Clone, Copy)]
pub(super) struct PromisedId {
    code: IdCode,
    number: u32,
    /// Whether any other id will do, too.
    is_any: bool,
}

impl Promised {
    /// The message that the receipt at `path` commits to, which has to be what is sought, or one of the ids that are.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when the receipt commits to something else.
    pub(super) fn find(sought: Option<Sought>, receipt: &Receipt, path: &Path, key: &Key) -> Result<Self, EngineError> {
        let prf = key.prf();
        let sought = sought.map_or_else(|| Sought::by_default(receipt, key), Ok)?;
        let found = match sought {
            Sought::Message(message) => Some(Self { message, id: None }),
            Sought::Id { code, id } => {
                let message = code.message(id, &code.pad(&prf)?)?;
                Some(Self { message, id: Some(PromisedId { code, number: id, is_any: false }) })
            }
            Sought::AnyId(code) => {
                let pad = code.pad(&prf)?;
                let messages = (0..code.id_bits().num_ids()).filter_map(|id| Some((id, code.message(id, &pad).ok()?)));
                let mut committed = messages.filter(|(_, message)| receipt.commits_to(message, &prf));
                let id = |number| Some(PromisedId { code, number, is_any: true });
                committed.next().map(|(number, message)| Self { message, id: id(number) })
            }
        };
        found.filter(|promised| receipt.commits_to(&promised.message, &prf)).ok_or_else(|| {
            let expected = "one to the message given with --message";
            bad_data(path, "message_mac", "a commitment to another message", expected)
        })
    }

    /// The message.
    pub(super) fn message(&self) -> Message {
        self.message
    }

    /// The id that it stands for, if it does.
    pub(super) fn id(&self) -> Option<PromisedId> {
        self.id
    }
}

impl PromisedId {
    /// Its code.
    pub(super) fn code(&self) -> IdCode {
        self.code
    }

    /// The id itself.
    pub(super) fn number(&self) -> u32 {
        self.number
    }

    /// Whether any other id will do, too.
    pub(super) fn is_any(&self) -> bool {
        self.is_any
    }
}
