//! How a film was made.

use serde::{Deserialize, Serialize};

use super::profile::Viewer;
use super::settings::Settings;

/// By whose renderer a film was drawn, at which settings, and whether it was made smaller since.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Making {
    /// Whose renderer, and how it was set.
    #[serde(flatten)]
    pub settings: Settings,
    /// How many times as large as the film it was drawn, along a side; 1 where it is as it was drawn.
    pub times: u32,
}

impl Making {
    /// How many times as large films are taken to have been drawn, the likelier first. It shows, as splats are drawn no
    /// narrower than a pixel.
    pub const TIMES: [u32; 2] = [1, 2];
}

impl Default for Making {
    fn default() -> Self {
        Self { settings: Viewer::Reference.into(), times: Self::TIMES[0] }
    }
}
