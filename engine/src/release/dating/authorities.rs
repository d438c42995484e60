//! Whom a verifier trusts: certificates given to it, and the way from a token's certificate to one of them.
//!
//! Ways are looked for as in RFC 5280, section 6, without policies, name constraints (critical ones are refused) and
//! revocation, which needs a network.

use std::path::Path;
use std::time::Duration;

use der::Decode as _;
use x509_cert::Certificate;

use super::certificate::{check_alone, check_issued};
use super::fault::Fault;
use crate::base::files::read_file;
use crate::error::EngineError;

/// Field of errors about certificates that were given.
const FIELD: &str = "certificates";

/// Certificates that are trusted: of authorities that issue others, or of a time-stamping authority itself.
#[derive(Clone, Debug)]
pub struct Authorities {
    trusted: Vec<Certificate>,
}

impl Authorities {
    /// Reads files of certificates, in PEM, which may hold several, or in DER. None without a file.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], or [`EngineError::BadData`] for files without certificates.
    pub fn read<P: AsRef<Path>>(paths: &[P]) -> Result<Option<Self>, EngineError> {
        let mut trusted = Vec::new();
        for path in paths.iter().map(AsRef::as_ref) {
            let bytes = read_file(path, "certificates in PEM or DER")?;
            trusted.extend(certificates(&bytes).map_err(|fault| fault.at(path))?);
        }
        Ok((!trusted.is_empty()).then_some(Self { trusted }))
    }

    /// Checks that the certificate of whoever made a token leads to one that is trusted, perhaps over `others`, at the
    /// time `at` since 1970.
    ///
    /// # Errors
    /// A [`Fault`] that says where the way ends.
    pub(super) fn check(&self, own: &Certificate, others: &[Certificate], at: Duration) -> Result<(), Fault> {
        let mut search = Search { trusted: &self.trusted, untried: others.iter().collect(), at };
        search.climb(own, 0)
    }
}

fn certificates(bytes: &[u8]) -> Result<Vec<Certificate>, Fault> {
    let is_pem = bytes.windows(b"-----BEGIN".len()).any(|window| window == b"-----BEGIN");
    let found = match is_pem {
        true => Certificate::load_pem_chain(bytes),
        false => Certificate::from_der(bytes).map(|one| vec![one]),
    };
    let found = found.map_err(Fault::parsing(FIELD, "X.509 certificates in PEM or DER"))?;
    match found.is_empty() {
        true => Err(Fault::new(FIELD, "none", "at least one")),
        false => Ok(found),
    }
}

/// A search for a way up. Each certificate of the token is tried once, so that no token can make it long.
struct Search<'a> {
    trusted: &'a [Certificate],
    untried: Vec<&'a Certificate>,
    at: Duration,
}

impl<'a> Search<'a> {
    /// Goes on from `certificate`, which has `below` others below it.
    fn climb(&mut self, certificate: &Certificate, below: usize) -> Result<(), Fault> {
        check_alone(certificate, self.at)?;
        if self.trusted.contains(certificate) {
            return Ok(());
        }
        let tbs = certificate.tbs_certificate();
        let got = format!("{}, issued by {}", tbs.subject(), tbs.issuer());
        let mut why = Fault::new("authority", got, "one that leads to a certificate given by --ca");
        let has_issued = |other: &Certificate| other.tbs_certificate().subject() == tbs.issuer();
        for issuer in self.trusted.iter().filter(|other| has_issued(other)) {
            match check_alone(issuer, self.at).and_then(|()| check_issued(certificate, issuer, below)) {
                Ok(()) => return Ok(()),
                Err(fault) => why = fault,
            }
        }
        while let Some(place) = self.untried.iter().position(|other| has_issued(other)) {
            let issuer = self.untried.swap_remove(place);
            match check_issued(certificate, issuer, below).and_then(|()| self.climb(issuer, below + 1)) {
                Ok(()) => return Ok(()),
                Err(fault) => why = fault,
            }
        }
        Err(why)
    }
}
