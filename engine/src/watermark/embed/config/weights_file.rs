//! Networks that settings name: by path and hash in files, and opened before work begins.

use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::digest::Digest;
use crate::error::EngineError;
use crate::networks::lpips::LpipsWeights;
use crate::watermark::extractor::pretrained::PretrainedExtractor;

/// What a [`WeightsFile`] can hold.
pub trait Weights: Sized {
    /// What messages call it.
    const WHAT: &str;

    /// The one in a file, or the built-in one where no file is named and there is such a one.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] or [`EngineError::BadData`] naming the file; [`EngineError::Usage`] where none is
    /// named and none is built in.
    fn open(path: Option<&Path>) -> Result<Self, EngineError>;

    /// Hash that tells it from others.
    ///
    /// # Errors
    /// When it is not whole.
    fn hash(&self) -> Result<Digest, EngineError>;
}

impl Weights for PretrainedExtractor {
    const WHAT: &str = "pretrained extractor";

    fn open(path: Option<&Path>) -> Result<Self, EngineError> {
        Self::open(path)
    }

    fn hash(&self) -> Result<Digest, EngineError> {
        self.digest()
    }
}

impl Weights for LpipsWeights {
    const WHAT: &str = "LPIPS weights";

    fn open(path: Option<&Path>) -> Result<Self, EngineError> {
        match path {
            Some(path) => Self::read(path),
            None => Err(EngineError::Usage {
                what: Self::WHAT.to_owned(),
                got: "no file".to_owned(),
                expected: "the path of a safetensors file: none is built in".to_owned(),
            }),
        }
    }

    fn hash(&self) -> Result<Digest, EngineError> {
        Ok(self.digest())
    }
}

/// A network by its file.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, bound = "")]
pub struct WeightsFile<T> {
    /// The file; without one it is what is built in, or what the program that wrote these settings had at hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    path: Option<PathBuf>,
    /// Hash that it has to have; without one any will do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    blake3: Option<Digest>,
    #[serde(skip)]
    opened: Option<Arc<T>>,
}

impl<T> Clone for WeightsFile<T> {
    fn clone(&self) -> Self {
        Self { path: self.path.clone(), blake3: self.blake3, opened: self.opened.clone() }
    }
}

impl<T> Default for WeightsFile<T> {
    fn default() -> Self {
        Self { path: None, blake3: None, opened: None }
    }
}

/// The path of a file.
impl<T> FromStr for WeightsFile<T> {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self { path: Some(PathBuf::from(text)), ..Self::default() })
    }
}

impl<T: Weights> WeightsFile<T> {
    /// What is open already, without a path.
    ///
    /// # Errors
    /// Those of [`Weights::hash`].
    pub fn of(weights: Arc<T>) -> Result<Self, EngineError> {
        Ok(Self { path: None, blake3: Some(weights.hash()?), opened: Some(weights) })
    }

    /// Opens the file, unless it is open.
    ///
    /// # Errors
    /// Those of [`Weights::open`]; [`EngineError::BadData`] when it has another hash than these settings name.
    pub(super) fn open(&mut self) -> Result<(), EngineError> {
        if self.opened.is_some() {
            return Ok(());
        }
        let weights = T::open(self.path.as_deref())?;
        let (found, wanted) = (weights.hash()?, self.blake3.get_or_insert(weights.hash()?));
        if found != *wanted {
            return Err(EngineError::BadData {
                path: self.path.clone().unwrap_or_else(|| PathBuf::from(format!("the built-in {}", T::WHAT))),
                field: "blake3".to_owned(),
                got: found.to_string(),
                expected: format!("{wanted}, which the settings name"),
            });
        }
        self.opened = Some(Arc::new(weights));
        Ok(())
    }

    /// What was opened.
    ///
    /// # Errors
    /// [`EngineError::Usage`] before it was.
    pub fn get(&self) -> Result<&Arc<T>, EngineError> {
        self.opened.as_ref().ok_or_else(|| EngineError::Usage {
            what: T::WHAT.to_owned(),
            got: "none".to_owned(),
            expected: "one that was opened".to_owned(),
        })
    }

    /// Forgets where the file lies; its hash says what it is.
    pub(super) fn forget_path(&mut self) {
        self.path = None;
    }
}
