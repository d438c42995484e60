//! Kinds of distortions, by name, with the strength that is really applied.
//!
//! Named strengths of the field are not always what its code applies (noise "0.1" with a standard deviation of 0.01,
//! crops given by side or by area); here the number is the physical one, and every variant says its unit.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::error::EngineError;

/// One kind of distortion. The frame keeps its size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DistortionKind {
    /// Nothing but the rounding to 8 bits that every distortion ends with.
    Identity,
    /// Gaussian noise; strength: its standard deviation where colours are in \[0, 1\].
    Noise,
    /// A turn about the middle, read bilinearly, black outside; strength: degrees counterclockwise.
    Rotation,
    /// Antialiased bilinear to a smaller size and back; strength: that size as a share of each side.
    Rescale,
    /// Gaussian blur, cut off at three standard deviations, mirrored at the border; strength: the standard deviation in
    /// pixels.
    Blur,
    /// The middle part, enlarged to the frame bilinearly; strength: that part as a share of each side.
    Crop,
    /// Left and right swapped.
    Mirror,
    /// All colours times the strength, then clamped.
    Brightness,
    /// Baseline JPEG with 4:2:0 chroma; strength: the quality, 1 to 100, on libjpeg's scale.
    Jpeg,
    /// What a video codec leaves of a faint mark, as a filter: chroma at half resolution, then a Gaussian low pass.
    /// Strength: its standard deviation in pixels. With 2, cells of 1, 4 and 16 px keep 0, 0.3 and 0.9 of their
    /// amplitude, about what H.264 at CRF 18 to 28 leaves of a mark of 50 dB; unlike a codec it also takes the
    /// content's sharp edges.
    Codec,
}

/// Name, least and greatest strength, and whether the strength can be drawn anew for every step.
struct Facts {
    kind: DistortionKind,
    name: &'static str,
    strengths: RangeInclusive<f64>,
    is_drawn: bool,
}

const fn facts(kind: DistortionKind, name: &'static str, strengths: RangeInclusive<f64>, is_drawn: bool) -> Facts {
    Facts { kind, name, strengths, is_drawn }
}

/// All kinds. Those that need tables on the device have fixed strengths in training: a step makes none.
const FACTS: [Facts; 10] = [
    facts(DistortionKind::Identity, "identity", 0.0..=0.0, false),
    facts(DistortionKind::Noise, "noise", 0.0..=1.0, true),
    facts(DistortionKind::Rotation, "rotation", -180.0..=180.0, true),
    facts(DistortionKind::Rescale, "rescale", 0.05..=1.0, false),
    facts(DistortionKind::Blur, "blur", 0.1..=20.0, false),
    facts(DistortionKind::Crop, "crop", 0.05..=1.0, true),
    facts(DistortionKind::Mirror, "mirror", 0.0..=0.0, false),
    facts(DistortionKind::Brightness, "brightness", 0.0..=4.0, true),
    facts(DistortionKind::Jpeg, "jpeg", 1.0..=100.0, false),
    facts(DistortionKind::Codec, "codec", 0.1..=20.0, false),
];

impl DistortionKind {
    fn facts(self) -> &'static Facts {
        FACTS.iter().find(|facts| facts.kind == self).expect("every kind has its facts")
    }

    /// Name in files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.facts().name
    }

    /// Whether it can be weak or strong.
    fn has_strength(self) -> bool {
        self.facts().strengths != (0.0..=0.0)
    }
}

/// A kind with the strengths it is applied at; a single one where both ends are the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    kind: DistortionKind,
    low: f64,
    high: f64,
}

impl Distortion {
    /// A kind at one strength.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a strength that it cannot have.
    pub fn new(kind: DistortionKind, strength: f64) -> Result<Self, EngineError> {
        Self::between(kind, strength, strength)
    }

    fn between(kind: DistortionKind, low: f64, high: f64) -> Result<Self, EngineError> {
        let facts = kind.facts();
        let this = Self { kind, low, high };
        let usage = |expected: String| {
            Err(EngineError::Usage { what: "distortion".to_owned(), got: this.to_string(), expected })
        };
        // NaN is in no range.
        if !(facts.strengths.contains(&low) && facts.strengths.contains(&high) && low <= high) {
            let (least, most) = (facts.strengths.start(), facts.strengths.end());
            return usage(format!("{} with a strength from {least} to {most}", facts.name));
        }
        if kind == DistortionKind::Jpeg && low.fract() != 0.0 {
            return usage("jpeg with a whole quality".to_owned());
        }
        if low < high && !facts.is_drawn {
            return usage(format!("{} with one strength; several can be listed", facts.name));
        }
        Ok(this)
    }

    /// What it is.
    #[must_use]
    pub const fn kind(&self) -> DistortionKind {
        self.kind
    }

    /// Whether it has one strength only.
    #[must_use]
    pub fn is_fixed(&self) -> bool {
        self.low >= self.high
    }

    /// The strength at `share`, 0 to 1, of the way from the least to the greatest.
    #[must_use]
    pub fn strength(&self, share: f64) -> f64 {
        self.low + share * (self.high - self.low)
    }
}

impl fmt::Display for Distortion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, low, high } = self;
        let name = kind.name();
        match (kind.has_strength(), self.is_fixed()) {
            (false, _) => write!(f, "{name}"),
            (true, true) => write!(f, "{name}:{low}"),
            (true, false) => write!(f, "{name}:{low}..{high}"),
        }
    }
}

/// `identity` or `mirror`, `jpeg:50`, or with strengths between two numbers `rotation:-15..15`.
impl FromStr for Distortion {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        let bad = || {
            let examples: Vec<String> = FACTS.iter().map(|facts| facts.name.to_owned()).collect();
            EngineError::Usage {
                what: "distortion".to_owned(),
                got: text.to_owned(),
                expected: format!("NAME:STRENGTH or NAME:LEAST..GREATEST, NAME one of {}", examples.join(", ")),
            }
        };
        let (name, strength) = text.split_once(':').unwrap_or((text, ""));
        let kind = FACTS.iter().find(|facts| facts.name == name).ok_or_else(bad)?.kind;
        if !kind.has_strength() {
            return if strength.is_empty() { Self::new(kind, 0.0) } else { Err(bad()) };
        }
        let (low, high) = strength.split_once("..").unwrap_or((strength, strength));
        let number = |text: &str| text.parse::<f64>().map_err(|_| bad());
        Self::between(kind, number(low)?, number(high)?)
    }
}

impl Serialize for Distortion {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Distortion {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}
