//! What a single certificate has to be: RFC 5280 for all of them, RFC 3161, section 2.3, for that of an authority.

use std::time::Duration;

use der::Encode as _;
use der::asn1::ObjectIdentifier;
use x509_cert::Certificate;
use x509_cert::ext::pkix::{BasicConstraints, ExtendedKeyUsage, KeyUsage};

use super::fault::Fault;
use super::signature::Signed;

const TIME_STAMPING: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.3.6.1.5.5.7.3.8");
const ANY_USAGE: ObjectIdentifier = ObjectIdentifier::new_unwrap("2.5.29.37.0");

/// Extensions that may be critical: key usage, alternative names, constraints, policies, extended key usage. The
/// policies of all authorities that are trusted at all are fine.
const KNOWN: [ObjectIdentifier; 5] = [
    ObjectIdentifier::new_unwrap("2.5.29.15"),
    ObjectIdentifier::new_unwrap("2.5.29.17"),
    ObjectIdentifier::new_unwrap("2.5.29.19"),
    ObjectIdentifier::new_unwrap("2.5.29.32"),
    ObjectIdentifier::new_unwrap("2.5.29.37"),
];

fn extension_fault(error: der::Error) -> Fault {
    Fault::new("certificate.extensions", error, "those of RFC 5280, each once")
}

/// Checks that a certificate may sign dates, and nothing else.
///
/// # Errors
/// A [`Fault`] unless its one extended key usage is time stamping, and critical.
pub(super) fn check_stamps(certificate: &Certificate) -> Result<(), Fault> {
    let tbs = certificate.tbs_certificate();
    let usage = tbs.get_extension::<ExtendedKeyUsage>().map_err(extension_fault)?;
    let expected = "time stamping alone, and critical";
    match usage {
        Some((true, ExtendedKeyUsage(purposes))) if purposes == [TIME_STAMPING] => {}
        Some((true, _)) => return Err(Fault::new("certificate.extKeyUsage", "other purposes", expected)),
        Some((false, _)) => return Err(Fault::new("certificate.extKeyUsage", "not critical", expected)),
        None => return Err(Fault::new("certificate.extKeyUsage", "none", expected)),
    }
    let key_usage = tbs.get_extension::<KeyUsage>().map_err(extension_fault)?;
    match key_usage.is_none_or(|(_, usage)| usage.digital_signature() || usage.non_repudiation()) {
        true => Ok(()),
        false => Err(Fault::new("certificate.keyUsage", "not for signatures", "digitalSignature or nonRepudiation")),
    }
}

/// Checks a certificate by itself at a time since 1970.
///
/// # Errors
/// A [`Fault`] if it is not valid then, or has a critical extension that is not known here.
pub(super) fn check_alone(certificate: &Certificate, at: Duration) -> Result<(), Fault> {
    let tbs = certificate.tbs_certificate();
    let validity = tbs.validity();
    let [from, to] = [validity.not_before, validity.not_after].map(|time| time.to_unix_duration().as_secs());
    if !(from..=to).contains(&at.as_secs()) {
        let got = format!("{} is valid from {} to {}", tbs.subject(), validity.not_before, validity.not_after);
        return Err(Fault::new("certificate.validity", got, "the token's date within"));
    }
    let unknown = |id: &ObjectIdentifier| !KNOWN.contains(id);
    let critical = tbs.extensions().into_iter().flatten().filter(|extension| extension.critical);
    match critical.map(|extension| extension.extn_id).find(unknown) {
        Some(id) => Err(Fault::new("certificate.extensions", id, "no critical one but those of key usage and names")),
        None => Ok(()),
    }
}

/// Checks that `issuer` may issue certificates for time stamping, and has issued `certificate`. `between` is the number
/// of issuers between `issuer` and the authority's own certificate.
///
/// # Errors
/// A [`Fault`] if not.
pub(super) fn check_issued(certificate: &Certificate, issuer: &Certificate, between: usize) -> Result<(), Fault> {
    let tbs = issuer.tbs_certificate();
    let fault = |got: &str, expected: &str| {
        Err(Fault::new("certificate.issuer", format!("{}: {got}", tbs.subject()), expected))
    };
    match tbs.get_extension::<BasicConstraints>().map_err(extension_fault)? {
        Some((_, BasicConstraints { ca: true, path_len_constraint: most })) => {
            if most.is_some_and(|most| between > usize::from(most)) {
                return fault(&format!("{between} issuers below it"), "no more than it allows");
            }
        }
        _ => return fault("not for issuing certificates", "a certificate authority"),
    }
    let key_usage = tbs.get_extension::<KeyUsage>().map_err(extension_fault)?;
    if key_usage.is_some_and(|(_, usage)| !usage.key_cert_sign()) {
        return fault("its key is not for issuing certificates", "a certificate authority");
    }
    let purposes = tbs.get_extension::<ExtendedKeyUsage>().map_err(extension_fault)?;
    let stamps = |ids: &[ObjectIdentifier]| ids.contains(&TIME_STAMPING) || ids.contains(&ANY_USAGE);
    if purposes.is_some_and(|(_, ExtendedKeyUsage(ids))| !stamps(&ids)) {
        return fault("only for other purposes", "an authority for time stamping too");
    }
    check_signature(certificate, issuer)
}

/// Checks the signature of `issuer` under `certificate`.
fn check_signature(certificate: &Certificate, issuer: &Certificate) -> Result<(), Fault> {
    let (tbs, field) = (certificate.tbs_certificate(), "certificate.signature");
    if tbs.signature() != certificate.signature_algorithm() {
        return Err(Fault::new(field, certificate.signature_algorithm().oid, "the algorithm that is signed"));
    }
    let message = tbs.to_der().map_err(Fault::parsing(field, "a certificate"))?;
    let octets = certificate.signature().as_bytes();
    let signature = octets.ok_or_else(|| Fault::new(field, "a part of a byte", "whole bytes"))?;
    let algorithm = certificate.signature_algorithm();
    let signed = Signed { field, algorithm, hash: None, message: &message, signature };
    signed.check(issuer.tbs_certificate().subject_public_key_info())
}
