//! What is asked of an authority: `TimeStampReq` of RFC 3161, section 2.4.1.

use std::path::Path;

use der::asn1::{Int, Null, ObjectIdentifier, OctetString};
use der::{Any, Decode as _, Encode as _, Sequence};
use x509_cert::ext::Extension;
use x509_cert::spki::AlgorithmIdentifierOwned;

use super::fault::Fault;
use super::subject::imprint;
use super::tst_info::MessageImprint;
use crate::base::digest::Digest;
use crate::base::files::{bad_data, read_file};
use crate::base::output::{AtomicFile, Existing};
use crate::base::prf::fill_unpredictably;
use crate::error::EngineError;

const SHA_256: ObjectIdentifier = ObjectIdentifier::new_unwrap("2.16.840.1.101.3.4.2.1");

/// Bytes of the number that ties a response to its request.
const NONCE_BYTES: usize = 8;

/// A request.
#[derive(Clone, Debug, PartialEq, Eq, Sequence)]
struct TimeStampReq {
    version: u8,
    imprint: MessageImprint,
    #[asn1(optional = "true")]
    policy: Option<ObjectIdentifier>,
    #[asn1(optional = "true")]
    nonce: Option<Int>,
    #[asn1(default = "Default::default")]
    certificates: bool,
    #[asn1(context_specific = "0", tag_mode = "IMPLICIT", constructed = "true", optional = "true")]
    extensions: Option<Vec<Extension>>,
}

/// Asks for a date on a commitment or root: its SHA-256, a random number, and the authority's certificates.
#[derive(Clone, Debug)]
pub struct Request {
    asked: TimeStampReq,
}

impl Request {
    /// A new request for `digest`.
    ///
    /// # Errors
    /// [`EngineError::Program`] if the system has no working random source.
    pub fn new(digest: &Digest) -> Result<Self, EngineError> {
        let mut nonce = [0; NONCE_BYTES];
        fill_unpredictably(&mut nonce)?;
        // A first byte of 0x40 to 0x7f: positive, and as long as it can be.
        nonce[0] = nonce[0] & 0x3f | 0x40;
        let asked = TimeStampReq {
            version: 1,
            imprint: sha_256(digest),
            policy: None,
            nonce: Some(Int::new(&nonce).expect("eight bytes are an integer")),
            certificates: true,
            extensions: None,
        };
        Ok(Self { asked })
    }

    /// Reads a request.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], or [`EngineError::BadData`] for anything else.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        let der = read_file(path, "a request written by `guard4d timestamp request`")?;
        let asked = TimeStampReq::from_der(&der);
        let asked = asked.map_err(|error| Fault::parsing("TimeStampReq", "that of RFC 3161")(error).at(path))?;
        Ok(Self { asked })
    }

    /// Writes the request in DER.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if the file exists and may not be replaced; [`EngineError::Io`].
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), EngineError> {
        let der = self.asked.to_der().expect("what was decoded or made here can be encoded");
        AtomicFile::write(path, existing, &der)
    }

    /// Checks that this request, which came from `path`, asks for a date on `digest`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] if it is for something else.
    pub fn check(&self, path: &Path, digest: &Digest) -> Result<(), EngineError> {
        if self.asked.imprint.hash.as_bytes() == imprint(digest) {
            return Ok(());
        }
        let got = hex::encode(self.asked.imprint.hash.as_bytes());
        let expected = format!("{}, the SHA-256 of {digest}", hex::encode(imprint(digest)));
        Err(bad_data(path, "messageImprint", got, expected))
    }

    /// Its random number.
    pub(super) fn nonce(&self) -> Option<&Int> {
        self.asked.nonce.as_ref()
    }
}

/// The imprint of a commitment or root: SHA-256 of its 32 bytes.
fn sha_256(digest: &Digest) -> MessageImprint {
    MessageImprint {
        algorithm: AlgorithmIdentifierOwned { oid: SHA_256, parameters: Some(Any::from(Null)) },
        hash: OctetString::new(imprint(digest)).expect("32 bytes are an octet string"),
    }
}
