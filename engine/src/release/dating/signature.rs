//! Signatures that tokens and certificates bear: RSA as in PKCS #1 v1.5 (RFC 8017, section 8.2), and ECDSA on P-256
//! and P-384 (RFC 5758), each with SHA-256, SHA-384 or SHA-512.
//!
//! Only public keys are at work here, so that nothing secret can leak through how long it takes.

use der::asn1::{Null, ObjectIdentifier};
use der::referenced::OwnedToRef as _;
use p256::ecdsa::signature::hazmat::PrehashVerifier as _;
use rsa::pkcs1v15::Pkcs1v15Sign;
use rsa::traits::PublicKeyParts as _;
use sha2::{Digest as _, Sha256, Sha384, Sha512};
use x509_cert::spki::{AlgorithmIdentifierOwned, SubjectPublicKeyInfoOwned, SubjectPublicKeyInfoRef};

use super::fault::Fault;

const RSA: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.1.1");
const EC: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.10045.2.1");
const P256: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.10045.3.1.7");
const P384: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.3.132.0.34");

/// Shortest modulus that is believed, in bits (NIST SP 800-131A).
const MIN_RSA_BITS: u32 = 2048;

/// A hash of the second generation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hash {
    Sha256,
    Sha384,
    Sha512,
}

/// Names of a hash: by itself, with RSA, with ECDSA.
const NAMES: [(Hash, [&str; 3]); 3] = [
    (Hash::Sha256, ["2.16.840.1.101.3.4.2.1", "1.2.840.113549.1.1.11", "1.2.840.10045.4.3.2"]),
    (Hash::Sha384, ["2.16.840.1.101.3.4.2.2", "1.2.840.113549.1.1.12", "1.2.840.10045.4.3.3"]),
    (Hash::Sha512, ["2.16.840.1.101.3.4.2.3", "1.2.840.113549.1.1.13", "1.2.840.10045.4.3.4"]),
];

impl Hash {
    /// The hash that an algorithm identifier names.
    ///
    /// # Errors
    /// A [`Fault`] about `field` for another one, and for parameters.
    pub(super) fn named(algorithm: &AlgorithmIdentifierOwned, field: &'static str) -> Result<Self, Fault> {
        check_parameters(algorithm, field)?;
        let named = NAMES.iter().find(|(_, [alone, ..])| is_named(algorithm.oid, alone));
        let unknown = || Fault::new(field, algorithm.oid, "SHA-256, SHA-384 or SHA-512");
        named.map(|(hash, _)| *hash).ok_or_else(unknown)
    }

    pub(super) fn of(self, bytes: &[u8]) -> Vec<u8> {
        match self {
            Self::Sha256 => Sha256::digest(bytes).to_vec(),
            Self::Sha384 => Sha384::digest(bytes).to_vec(),
            Self::Sha512 => Sha512::digest(bytes).to_vec(),
        }
    }

    /// The scheme whose signatures name this hash inside.
    fn rsa_scheme(self) -> Pkcs1v15Sign {
        match self {
            Self::Sha256 => Pkcs1v15Sign::new::<Sha256>(),
            Self::Sha384 => Pkcs1v15Sign::new::<Sha384>(),
            Self::Sha512 => Pkcs1v15Sign::new::<Sha512>(),
        }
    }
}

fn is_named(oid: ObjectIdentifier, name: &str) -> bool {
    ObjectIdentifier::new(name).is_ok_and(|known| known == oid)
}

/// Refuses parameters, but for the NULL that RSA and older writers put in their place (RFC 5754).
fn check_parameters(algorithm: &AlgorithmIdentifierOwned, field: &'static str) -> Result<(), Fault> {
    match &algorithm.parameters {
        Some(given) if given.decode_as::<Null>().is_err() => Err(Fault::new(field, "parameters", "none")),
        _ => Ok(()),
    }
}

/// What was signed, and how that is told.
pub(super) struct Signed<'a> {
    /// Field that errors name.
    pub(super) field: &'static str,
    pub(super) algorithm: &'a AlgorithmIdentifierOwned,
    /// The hash, where the algorithm's name need not say it: beside bare RSA in a CMS message.
    pub(super) hash: Option<Hash>,
    pub(super) message: &'a [u8],
    pub(super) signature: &'a [u8],
}

impl Signed<'_> {
    /// Checks the signature with the public key of whoever is said to have made it.
    ///
    /// # Errors
    /// A [`Fault`] for a signature that is not of this key and message, and for keys and algorithms that are not read.
    pub(super) fn check(&self, key: &SubjectPublicKeyInfoOwned) -> Result<(), Fault> {
        let (kind, hash) = self.kind()?;
        if key.algorithm.oid != kind {
            return Err(self.fault(format!("{} by a key of {}", self.algorithm.oid, key.algorithm.oid)));
        }
        let digest = hash.of(self.message);
        let is_good = match kind {
            RSA => self.is_good_rsa(key.owned_to_ref(), hash, &digest),
            _ => self.is_good_ec(key, &digest),
        };
        is_good.ok_or_else(|| self.fault("one that the key named did not make".to_owned()))
    }

    fn fault(&self, got: String) -> Fault {
        let expected = "a signature by RSA (PKCS #1 v1.5, from 2048 bits) or ECDSA (P-256, P-384) with SHA-2";
        Fault::new(self.field, got, expected)
    }

    /// The kind of key, and the hash.
    fn kind(&self) -> Result<(ObjectIdentifier, Hash), Fault> {
        check_parameters(self.algorithm, self.field)?;
        let oid = self.algorithm.oid;
        let named = NAMES.iter().find_map(|(hash, [_, rsa, ec])| match oid {
            _ if is_named(oid, rsa) => Some((RSA, *hash)),
            _ if is_named(oid, ec) => Some((EC, *hash)),
            _ => None,
        });
        let bare = self.hash.filter(|_| oid == RSA).map(|hash| (RSA, hash));
        let (kind, hash) = named.or(bare).ok_or_else(|| self.fault(oid.to_string()))?;
        match self.hash.filter(|said| *said != hash) {
            Some(said) => Err(self.fault(format!("{oid}, beside {said:?}"))),
            None => Ok((kind, hash)),
        }
    }

    fn is_good_rsa(&self, key: SubjectPublicKeyInfoRef<'_>, hash: Hash, digest: &[u8]) -> Option<()> {
        let key = rsa::PublicKey::try_from(key).ok().filter(|key| key.n().bit_width() >= MIN_RSA_BITS)?;
        key.verify(hash.rsa_scheme(), digest, self.signature).ok()
    }

    fn is_good_ec(&self, key: &SubjectPublicKeyInfoOwned, digest: &[u8]) -> Option<()> {
        let curve: ObjectIdentifier = key.algorithm.parameters.as_ref()?.decode_as().ok()?;
        match curve {
            P256 => {
                let signature = p256::ecdsa::Signature::from_der(self.signature).ok()?;
                let key = p256::ecdsa::VerifyingKey::try_from(key.owned_to_ref()).ok()?;
                key.verify_prehash(digest, &signature).ok()
            }
            P384 => {
                let signature = p384::ecdsa::Signature::from_der(self.signature).ok()?;
                let key = p384::ecdsa::VerifyingKey::try_from(key.owned_to_ref()).ok()?;
                key.verify_prehash(digest, &signature).ok()
            }
            _ => None,
        }
    }
}
