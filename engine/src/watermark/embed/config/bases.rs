//! Which coefficients have offsets, as flags and files spell it: `dc` or `all`.

use guard4d_kernels::shape::OffsetBases;
use serde::de::Error as _;
use serde::{Deserialize as _, Deserializer, Serializer};

/// As a flag.
pub(super) fn parse(text: &str) -> Result<OffsetBases, String> {
    match text {
        "dc" => Ok(OffsetBases::Dc),
        "all" => Ok(OffsetBases::All),
        _ => Err(format!("`{text}`: expected one of dc, all")),
    }
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
pub(super) fn serialize<S: Serializer>(bases: &OffsetBases, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(match bases {
        OffsetBases::Dc => "dc",
        OffsetBases::All => "all",
    })
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<OffsetBases, D::Error> {
    parse(&String::deserialize(from)?).map_err(D::Error::custom)
}
