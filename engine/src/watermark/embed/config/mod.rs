//! What an embedding is asked to do. The same structs are the command line's flags, the keys of a settings file, and
//! what a receipt records.

mod bases;
mod embed_config;
mod extractor;
mod fidelity;
mod flags;
mod objective;
mod optimiser;
mod parse;
mod profile;
mod schedule;
mod terms;
mod training_camera;
mod training_views;
pub(super) mod turns;
mod weights_file;

pub use embed_config::EmbedConfig;
pub use extractor::{
    BlindConfig, CalibrationConfig, ColourConfig, ContentChoice, Extractor, JointConfig, NoneConfig, PretrainedConfig,
};
pub use fidelity::Fidelity;
pub use objective::Objective;
pub use optimiser::Optimiser;
pub use profile::Profile;
pub use schedule::{AdaptiveSchedule, Aim, Phase};
pub use terms::{Control, ControlClips, LpipsTerm};
pub use training_camera::TrainingCamera;
pub use training_views::{FramingChoice, TrainingViews};
pub use weights_file::{Weights, WeightsFile};
