//! What an authority signs: `TSTInfo` of RFC 3161, section 2.4.2, and the moment in it.

use std::fmt;
use std::time::Duration;

use der::asn1::{Any, GeneralizedTime, Int, ObjectIdentifier, OctetString};
use der::{Decode as _, Encode as _, Sequence, Tag, Tagged as _};
use x509_cert::ext::Extension;
use x509_cert::spki::AlgorithmIdentifierOwned;

use super::fault::Fault;

/// Characters of a time without fractions: YYYYMMDDhhmmss.
const WHOLE: usize = 14;

/// Nanoseconds have nine digits; finer fractions than these do not order dates.
const DIGITS: usize = 9;

/// A hash and how it was made.
#[derive(Clone, Debug, PartialEq, Eq, Sequence)]
pub(super) struct MessageImprint {
    pub(super) algorithm: AlgorithmIdentifierOwned,
    pub(super) hash: OctetString,
}

/// How far the moment may be off, either way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Sequence)]
pub(super) struct Accuracy {
    #[asn1(optional = "true")]
    seconds: Option<u32>,
    #[asn1(context_specific = "0", tag_mode = "IMPLICIT", optional = "true")]
    millis: Option<u16>,
    #[asn1(context_specific = "1", tag_mode = "IMPLICIT", optional = "true")]
    micros: Option<u16>,
}

impl Accuracy {
    /// In seconds.
    pub(super) fn seconds(&self) -> f64 {
        let [millis, micros] = [self.millis, self.micros].map(|part| f64::from(part.unwrap_or(0)));
        f64::from(self.seconds.unwrap_or(0)) + millis * 1e-3 + micros * 1e-6
    }
}

/// The signed statement. The moment is decoded by [`TstInfo::moment`], because it may have fractions, which
/// certificates' times may not.
#[derive(Clone, Debug, PartialEq, Eq, Sequence)]
pub(super) struct TstInfo {
    pub(super) version: u8,
    pub(super) policy: ObjectIdentifier,
    pub(super) imprint: MessageImprint,
    pub(super) serial: Int,
    gen_time: Any,
    #[asn1(optional = "true")]
    pub(super) accuracy: Option<Accuracy>,
    #[asn1(default = "Default::default")]
    ordering: bool,
    #[asn1(optional = "true")]
    pub(super) nonce: Option<Int>,
    #[asn1(context_specific = "0", tag_mode = "EXPLICIT", optional = "true")]
    authority: Option<Any>,
    #[asn1(context_specific = "1", tag_mode = "IMPLICIT", constructed = "true", optional = "true")]
    extensions: Option<Vec<Extension>>,
}

impl TstInfo {
    /// Parses the content of a token.
    ///
    /// # Errors
    /// A [`Fault`] for anything else, for another version, and for critical extensions, of which none is known.
    pub(super) fn parse(der: &[u8]) -> Result<Self, Fault> {
        let info = Self::from_der(der).map_err(Fault::parsing("TSTInfo", "that of RFC 3161"))?;
        if info.version != 1 {
            return Err(Fault::new("TSTInfo.version", info.version, 1));
        }
        if let Some(unknown) = info.extensions.iter().flatten().find(|extension| extension.critical) {
            return Err(Fault::new("TSTInfo.extensions", unknown.extn_id, "no critical one"));
        }
        Ok(info)
    }

    /// When the token was made.
    ///
    /// # Errors
    /// A [`Fault`] for what is no such time.
    pub(super) fn moment(&self) -> Result<Moment, Fault> {
        let text = String::from_utf8_lossy(self.gen_time.value());
        let bad = || Fault::new("TSTInfo.genTime", &text, "YYYYMMDDhhmmss[.fraction]Z");
        if self.gen_time.tag() != Tag::GeneralizedTime {
            return Err(bad());
        }
        Moment::parse(&text).ok_or_else(bad)
    }
}

/// A moment of universal time, to fractions of a second.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Moment {
    whole: GeneralizedTime,
    /// Digits behind the point, without a last 0.
    fraction: String,
}

impl Moment {
    /// Parses the characters of a `GeneralizedTime`, which may have fractions and must be of universal time (RFC 3161,
    /// section 2.4.2).
    fn parse(text: &str) -> Option<Self> {
        let (whole, rest) = text.split_at_checked(WHOLE)?;
        let fraction = match rest.strip_suffix('Z')? {
            "" => "",
            more => more.strip_prefix('.').filter(|digits| !digits.is_empty() && !digits.ends_with('0'))?,
        };
        if !fraction.bytes().all(|digit| digit.is_ascii_digit()) {
            return None;
        }
        // The parser of certificates' times knows the calendar.
        let der = Any::new(Tag::GeneralizedTime, format!("{whole}Z").into_bytes()).and_then(|any| any.to_der()).ok()?;
        let whole = GeneralizedTime::from_der(&der).ok()?;
        Some(Self { whole, fraction: fraction.to_owned() })
    }

    /// Time since 1970 in universal time, to the nanosecond.
    pub(super) fn since_1970(&self) -> Duration {
        let digits = &self.fraction[..self.fraction.len().min(DIGITS)];
        let nanos = format!("{digits:0<DIGITS$}").parse().unwrap_or(0);
        self.whole.to_unix_duration() + Duration::from_nanos(nanos)
    }
}

impl fmt::Display for Moment {
    /// As RFC 3339 writes it, such as `2026-11-24T10:05:00.25Z`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let whole = self.whole.to_date_time().to_string();
        let whole = whole.trim_end_matches('Z');
        match self.fraction.as_str() {
            "" => write!(f, "{whole}Z"),
            fraction => write!(f, "{whole}.{fraction}Z"),
        }
    }
}
