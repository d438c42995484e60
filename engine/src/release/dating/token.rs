//! A time-stamp token: what an authority says of a digest and a date, with its signature (RFC 3161, section 2.4.2, in
//! a CMS message, RFC 5652).

use std::path::Path;

use cms::cert::CertificateChoices;
use cms::content_info::{CmsVersion, ContentInfo};
use cms::signed_data::{SignedData, SignerIdentifier, SignerInfo};
use der::asn1::{Any, ObjectIdentifier, OctetString};
use der::{Decode as _, Encode as _, Sequence, Tag, Tagged as _};
use serde::Serialize;
use sha1::{Digest as _, Sha1};
use x509_cert::Certificate;
use x509_cert::ext::pkix::SubjectKeyIdentifier;
use x509_cert::spki::AlgorithmIdentifierOwned;

use super::authorities::Authorities;
use super::certificate::check_stamps;
use super::fault::{Fault, printable};
use super::request::Request;
use super::signature::{Hash, Signed};
use super::subject::imprint;
use super::tst_info::{Moment, TstInfo};
use crate::base::digest::Digest;
use crate::base::files::read_file;
use crate::base::output::{AtomicFile, Existing};
use crate::error::EngineError;

const SIGNED_DATA: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.7.2");
const TST_INFO: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.16.1.4");
const CONTENT_TYPE: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.3");
const MESSAGE_DIGEST: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.4");
const SIGNING_CERTIFICATE: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.16.2.12");
const SIGNING_CERTIFICATE_V2: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.16.2.47");

/// Largest token that is read, in bytes; real ones have a tenth of it.
const MAX_BYTES: usize = 1 << 16;

/// Which certificate signed, by its SHA-1 (RFC 2634, section 5.4).
#[derive(Sequence)]
struct SigningCertificate {
    certificates: Vec<CertificateId>,
    #[asn1(optional = "true")]
    _policies: Option<Any>,
}

#[derive(Sequence)]
struct CertificateId {
    hash: OctetString,
    #[asn1(optional = "true")]
    _issuer: Option<Any>,
}

/// The same by a hash that is named (RFC 5035, section 3).
#[derive(Sequence)]
struct SigningCertificateV2 {
    certificates: Vec<CertificateIdV2>,
    #[asn1(optional = "true")]
    _policies: Option<Any>,
}

#[derive(Sequence)]
struct CertificateIdV2 {
    /// SHA-256 unless it is there.
    #[asn1(optional = "true")]
    algorithm: Option<AlgorithmIdentifierOwned>,
    hash: OctetString,
    #[asn1(optional = "true")]
    _issuer: Option<Any>,
}

/// How far a date can be believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Trust {
    /// The token's certificate leads to an authority that the verifier has named.
    Checked,
    /// The token says so; whoever made it was not checked, and can be anyone.
    Claimed,
}

/// What a token says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stamp {
    /// When it was made: universal time, as RFC 3339 writes it.
    pub date: String,
    /// How far the date may be off either way, in seconds; none if the authority does not say.
    pub accuracy_s: Option<f64>,
    /// Name of whoever made it, from its certificate.
    pub authority: String,
    /// How far all this can be believed.
    pub trust: Trust,
    /// The token's number, in hexadecimal digits.
    pub serial: String,
    /// The rules under which it was made, as an object identifier.
    pub policy: String,
}

/// A token whose signature is that of the certificate in it. Whose certificate it is, [`Token::check_authority`] asks.
#[derive(Clone, Debug)]
pub struct Token {
    der: Vec<u8>,
    info: TstInfo,
    moment: Moment,
    own: Certificate,
    others: Vec<Certificate>,
}

impl Token {
    /// Reads a token.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], and those of [`Token::parse`].
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        Self::parse(path, &read_file(path, "a time-stamp token, as `guard4d timestamp attach` writes it")?)
    }

    /// Parses `der`, which came from `path`, and checks it as far as it can be without knowing whom to trust.
    ///
    /// # Errors
    /// [`EngineError::BadData`] unless it is a token of RFC 3161 with one signature, made by a certificate that is in
    /// it, names itself under the signature, and is for time stamping alone.
    pub fn parse(path: &Path, der: &[u8]) -> Result<Self, EngineError> {
        Self::open(der).map_err(|fault| fault.at(path))
    }

    fn open(der: &[u8]) -> Result<Self, Fault> {
        if der.len() > MAX_BYTES {
            return Err(Fault::new("size", format!("{} bytes", der.len()), format!("at most {MAX_BYTES}")));
        }
        let parsing = Fault::parsing("token", "a signed CMS message in DER");
        let outer = ContentInfo::from_der(der).map_err(&parsing)?;
        if outer.content_type != SIGNED_DATA {
            return Err(Fault::new("token.contentType", outer.content_type, SIGNED_DATA));
        }
        let signed: SignedData = outer.content.decode_as().map_err(&parsing)?;
        if signed.version != CmsVersion::V3 {
            return Err(Fault::new("token.version", format!("{:?}", signed.version), "V3"));
        }
        let content = content(&signed)?;
        let info = TstInfo::parse(content)?;
        let moment = info.moment()?;
        let [signer] = signed.signer_infos.0.as_slice() else {
            return Err(Fault::new("token.signerInfos", signed.signer_infos.0.len(), "one signature"));
        };
        let (own, others) = certificates(&signed, signer)?;
        let hash = check_hashes(&signed, signer)?;
        check_attributes(signer, hash, content, &own)?;
        check_stamps(&own)?;
        Ok(Self { der: der.to_vec(), info, moment, own, others })
    }

    /// Writes the token in DER.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if the file exists and may not be replaced; [`EngineError::Io`].
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), EngineError> {
        AtomicFile::write(path, existing, &self.der)
    }

    /// Whether this is a date on the commitment or root `digest`.
    #[must_use]
    pub fn is_of(&self, digest: &Digest) -> bool {
        let said = &self.info.imprint;
        let is_sha_256 = Hash::named(&said.algorithm, "").is_ok_and(|hash| hash == Hash::Sha256);
        is_sha_256 && said.hash.as_bytes() == imprint(digest)
    }

    /// Checks that this token, which came from `path`, is a date on the commitment or root `digest`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] if it is one on something else.
    pub fn check_imprint(&self, path: &Path, digest: &Digest) -> Result<(), EngineError> {
        if self.is_of(digest) {
            return Ok(());
        }
        let got = format!("{} by {}", hex::encode(self.info.imprint.hash.as_bytes()), self.info.imprint.algorithm.oid);
        let expected = format!("{}, the SHA-256 of {digest}", hex::encode(imprint(digest)));
        Err(Fault::new("TSTInfo.messageImprint", got, expected).at(path))
    }

    /// Checks that this token, which came from `path`, answers `request`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] if it has not the request's random number.
    pub fn check_nonce(&self, path: &Path, request: &Request) -> Result<(), EngineError> {
        let shown = |nonce: Option<&der::asn1::Int>| nonce.map_or("none".to_owned(), |n| hex::encode(n.as_bytes()));
        let (got, asked) = (self.info.nonce.as_ref(), request.nonce());
        match got == asked {
            true => Ok(()),
            false => Err(Fault::new("TSTInfo.nonce", shown(got), shown(asked)).at(path)),
        }
    }

    /// Checks that this token, which came from `path`, was made by somebody who is trusted, or named by one who is, and
    /// whose certificate was valid then.
    ///
    /// # Errors
    /// [`EngineError::BadData`] if not.
    pub fn check_authority(&self, path: &Path, authorities: &Authorities) -> Result<(), EngineError> {
        let checked = authorities.check(&self.own, &self.others, self.moment.since_1970());
        checked.map_err(|fault| fault.at(path))
    }

    /// When it was made.
    pub(super) fn moment(&self) -> &Moment {
        &self.moment
    }

    /// What it says, to be believed as far as `trust` goes.
    #[must_use]
    pub fn stamp(&self, trust: Trust) -> Stamp {
        Stamp {
            date: self.moment.to_string(),
            accuracy_s: self.info.accuracy.map(|accuracy| accuracy.seconds()),
            authority: printable(&self.own.tbs_certificate().subject().to_string()),
            trust,
            serial: hex::encode(self.info.serial.as_bytes()),
            policy: self.info.policy.to_string(),
        }
    }
}

/// What is signed.
fn content(signed: &SignedData) -> Result<&[u8], Fault> {
    let said = &signed.encap_content_info;
    if said.econtent_type != TST_INFO {
        return Err(Fault::new("token.eContentType", said.econtent_type, format!("{TST_INFO}, a date")));
    }
    let octets = said.econtent.as_ref().filter(|content| content.tag() == Tag::OctetString);
    octets.map(Any::value).ok_or_else(|| Fault::new("token.eContent", "none", "a date"))
}

/// The signer's certificate, and the others in the token.
fn certificates(signed: &SignedData, signer: &SignerInfo) -> Result<(Certificate, Vec<Certificate>), Fault> {
    let all = signed.certificates.iter().flat_map(|set| set.0.iter());
    let is_own = |certificate: &Certificate| {
        let tbs = certificate.tbs_certificate();
        match &signer.sid {
            SignerIdentifier::IssuerAndSerialNumber(id) => {
                signer.version == CmsVersion::V1
                    && *tbs.issuer() == id.issuer
                    && *tbs.serial_number() == id.serial_number
            }
            SignerIdentifier::SubjectKeyIdentifier(id) => {
                let own = tbs.get_extension::<SubjectKeyIdentifier>();
                signer.version == CmsVersion::V3 && own.is_ok_and(|own| own.is_some_and(|(_, own)| own == *id))
            }
        }
    };
    let known = all.filter_map(|choice| match choice {
        CertificateChoices::Certificate(certificate) => Some(certificate.clone()),
        CertificateChoices::Other(_) => None,
    });
    let (mut own, others): (Vec<_>, Vec<_>) = known.partition(is_own);
    match (own.pop(), own.is_empty()) {
        (Some(own), true) => Ok((own, others)),
        (None, _) => Err(Fault::new("token.certificates", "none of the signer", "the one that made the signature")),
        (Some(_), false) => Err(Fault::new("token.certificates", "several of the signer", "one")),
    }
}

/// The hash that the signer used, which is the only one that the message announces.
fn check_hashes(signed: &SignedData, signer: &SignerInfo) -> Result<Hash, Fault> {
    let hash = Hash::named(&signer.digest_alg, "signerInfo.digestAlgorithm")?;
    for announced in signed.digest_algorithms.iter() {
        let announced = Hash::named(announced, "token.digestAlgorithms")?;
        if announced != hash {
            return Err(Fault::new("token.digestAlgorithms", format!("{announced:?}"), format!("{hash:?} alone")));
        }
    }
    match signed.digest_algorithms.is_empty() {
        true => Err(Fault::new("token.digestAlgorithms", "none", format!("{hash:?}"))),
        false => Ok(hash),
    }
}

/// The value of a signed attribute that may stand there once; none if it is not there.
fn attribute<'a>(signer: &'a SignerInfo, id: ObjectIdentifier, name: &'static str) -> Result<Option<&'a Any>, Fault> {
    let mut all = signer.signed_attrs.iter().flat_map(|set| set.iter()).filter(|attribute| attribute.oid == id);
    match (all.next().map(|attribute| attribute.values.as_slice()), all.next()) {
        (None, _) => Ok(None),
        (Some([value]), None) => Ok(Some(value)),
        _ => Err(Fault::new(name, "several", "one")),
    }
}

/// Checks the signed attributes, and the signature over them (RFC 5652, section 5.4).
fn check_attributes(signer: &SignerInfo, hash: Hash, content: &[u8], own: &Certificate) -> Result<(), Fault> {
    let kind = attribute(signer, CONTENT_TYPE, "signedAttrs.contentType")?;
    if kind.and_then(|value| value.decode_as().ok()) != Some(TST_INFO) {
        return Err(Fault::new("signedAttrs.contentType", "another one or none", TST_INFO));
    }
    let digest = attribute(signer, MESSAGE_DIGEST, "signedAttrs.messageDigest")?;
    let digest: Option<OctetString> = digest.and_then(|value| value.decode_as().ok());
    if digest.is_none_or(|digest| digest.as_bytes() != hash.of(content)) {
        return Err(Fault::new("signedAttrs.messageDigest", "another one or none", "the hash of the content"));
    }
    check_named(signer, own)?;
    let Some(attributes) = &signer.signed_attrs else {
        return Err(Fault::new("signedAttrs", "none", "content type, message digest and signing certificate"));
    };
    let message = attributes.to_der().map_err(Fault::parsing("signedAttrs", "a set of attributes"))?;
    let signed = Signed {
        field: "signerInfo.signature",
        algorithm: &signer.signature_algorithm,
        hash: Some(hash),
        message: &message,
        signature: signer.signature.as_bytes(),
    };
    signed.check(own.tbs_certificate().subject_public_key_info())
}

/// Checks that the signature names the certificate that it is checked with, or else a certificate of the same key could
/// take its place.
fn check_named(signer: &SignerInfo, own: &Certificate) -> Result<(), Fault> {
    let field = "signedAttrs.signingCertificate";
    let other = || Fault::new(field, "another certificate", own.tbs_certificate().subject());
    let der = own.to_der().map_err(Fault::parsing(field, "a certificate"))?;
    let parsing = Fault::parsing(field, "that of RFC 2634 or RFC 5035");
    let first = attribute(signer, SIGNING_CERTIFICATE, field)?;
    if let Some(value) = first {
        let named: SigningCertificate = value.decode_as().map_err(&parsing)?;
        let named = named.certificates.first().ok_or_else(other)?;
        if named.hash.as_bytes() != Sha1::digest(&der).as_slice() {
            return Err(other());
        }
    }
    let second = attribute(signer, SIGNING_CERTIFICATE_V2, field)?;
    if let Some(value) = second {
        let named: SigningCertificateV2 = value.decode_as().map_err(&parsing)?;
        let named = named.certificates.first().ok_or_else(other)?;
        let hash = named.algorithm.as_ref().map_or(Ok(Hash::Sha256), |algorithm| Hash::named(algorithm, field))?;
        if named.hash.as_bytes() != hash.of(&der) {
            return Err(other());
        }
    }
    match (first, second) {
        (None, None) => Err(Fault::new(field, "none", "the hash of the certificate that signed")),
        _ => Ok(()),
    }
}
